// The page of a live run.
"use strict";

const SECONDS = 8;
const STATES = { running: "running", paused: "paused", resetting: "starting again" };
const plot = new ForcePlot(byId("plot"), 1);
let rows = [], run = null, paused = false, cut = null;

function writeCut() {
  byId("cut").hidden = cut === null;
  byId("cut").textContent = cut ? "Close" : "Cut open";
}

function write(figures) {
  paused = figures.state === "paused";
  if (!ending) {
    byId("state").textContent = STATES[figures.state];
    byId("state").className = `state ${figures.state}`;
    byId("pause").textContent = paused ? "Resume" : "Pause";
    byId("pause").disabled = byId("reset").disabled = figures.state === "resetting";
  }
  if (figures.run !== run) { rows = []; run = figures.run; }
  if (figures.time_s === undefined) return;
  byId("time").textContent = fixed(figures.time_s, 2);
  byId("force").firstChild.textContent = `${fixed(Math.hypot(...figures.force_N), 2)} `;
  byId("parts").textContent = `${figures.force_N.map((part) => fixed(part, 2).replace("-", "−")).join(", ")} N`;
  byId("device-name").hidden = byId("device").hidden = figures.device_N === null;
  if (figures.device_N !== null) byId("device").textContent = `${fixed(figures.device_N, 2)} N`;
  byId("torque").textContent = newtonMetres(figures.torque_Nm);
  byId("layer").textContent = figures.layer;
  byId("removed").textContent = `${fixed(figures.removed_mm3, 2)} mm³`;
  byId("tick").textContent = `${fixed(figures.tick_us, 0)} µs`;
  byId("late").textContent = `${fixed(figures.late_us, 0)} µs`;
  byId("missed").textContent = fixed(figures.missed, 0);
  byId("skipped").textContent = `${fixed(figures.skipped_ms, 0)} ms`;
}

listen(
  (hello) => {
    byId("scene").textContent = hello.scene;
    document.title = `tissue: ${hello.scene}, live`;
    drawLegend(hello.legend);
    cut = hello.cut;
    writeCut();
    picture.focus();
  },
  (news) => {
    write(news.figures);
    if (!news.loads.length) return;
    rows.push(...news.loads.map(([time, x, y, z]) => [time, x, y, z, Math.hypot(x, y, z)]));
    const last = Math.max(rows[rows.length - 1][0], SECONDS);
    rows = rows.filter((row) => row[0] >= last - SECONDS - 0.1);
    plot.show(rows, [last - SECONDS, last]);
  },
  "The run has ended. Its folder is named in the terminal.",
);
takeMouse(
  (event) => event.shiftKey || event.button === 2,
  (travel) => send("move", travel),
  (event, notches) => { if (event.shiftKey) zoom(notches); else send("depth", { notches: -notches }); },
);
byId("pause").addEventListener("click", () => send("pause", { on: !paused }));
byId("reset").addEventListener("click", () => send("reset"));
byId("end").addEventListener("click", end);
byId("cut").addEventListener("click", () => { cut = !cut; send("cut", { on: cut }); writeCut(); });
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === " " && event.target.tagName !== "BUTTON") send("pause", { on: !paused });
  else if (/^(Arrow(Left|Right|Up|Down)|Page(Up|Down)|s|w)$/.test(event.key)) send("key", { name: event.key });
  else return;
  event.preventDefault();
});

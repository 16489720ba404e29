// The page of a saved run.
"use strict";

const plot = new ForcePlot(byId("plot"), 0.01);
let rows = [], span = [0, 1], playing = false, dragged = false;

function write(figures) {
  playing = figures.playing;
  byId("play").textContent = playing ? "Pause" : "Play";
  byId("state").textContent = playing ? "playing" : "paused";
  byId("state").className = `state ${playing ? "running" : "over"}`;
  byId("shown").value = figures.chosen;
  byId("time").textContent = fixed(figures.time_s, 3);
  if (!dragged) byId("slider").value = figures.time_s;
  plot.show(rows, span, figures.time_s);
  if (figures.force_N === undefined) return;
  byId("force").firstChild.textContent = `${fixed(Math.hypot(...figures.force_N), 2)} `;
  byId("parts").textContent = `${figures.force_N.map((part) => fixed(part, 2).replace("-", "−")).join(", ")} N`;
  byId("torque").textContent = newtonMetres(figures.torque_Nm);
  for (const [name, words] of [
    ["removed", figures.removed_mm3 === null ? null : `${fixed(figures.removed_mm3, 2)} mm³`],
    ["layer", figures.layer],
  ]) {
    byId(name).hidden = byId(`${name}-name`).hidden = words === null;
    if (words !== null) byId(name).textContent = words;
  }
}

listen(
  (hello) => {
    byId("scene").textContent = hello.scene;
    document.title = `tissue: ${hello.scene}`;
    drawLegend(hello.legend, { hidden: hello.hidden });
    byId("shown").replaceChildren(...hello.choices.map(([name, words]) => new Option(words, name)));
    byId("shown").parentElement.hidden = hello.choices.length < 2;
    [rows, span] = [hello.rows, hello.span_s];
    [byId("slider").min, byId("slider").max] = span;
    byId("slider").disabled = byId("play").disabled = span[0] >= span[1];
  },
  write,
  "The page has ended. Run the command again to see the run once more.",
);
takeMouse(() => true, () => {}, (event, notches) => zoom(notches));
byId("slider").addEventListener("input", () => {
  dragged = true;
  send("play", { on: false });
  send("time", { time_s: Number(byId("slider").value) });
});
byId("slider").addEventListener("change", () => { dragged = false; });
byId("play").addEventListener("click", () => send("play", { on: !playing }));
byId("shown").addEventListener("change", () => send("field", { name: byId("shown").value }));
byId("end").addEventListener("click", end);
byId("plot").addEventListener("click", (event) => {
  const time = plot.timeAt(event.offsetX);
  if (time !== null) send("time", { time_s: time });
});
document.addEventListener("keydown", (event) => {
  if (event.key !== " " || ["BUTTON", "SELECT", "INPUT"].includes(event.target.tagName)) return;
  send("play", { on: !playing });
  event.preventDefault();
});

// The socket, the picture, and the mouse of both pages.
"use strict";

const byId = (name) => document.getElementById(name);
const picture = byId("picture");
const socket = new WebSocket(`ws://${location.host}/socket${location.search}`);
socket.binaryType = "arraybuffer";

let over = false, ending = false;

function send(what, values) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ do: what, ...values }));
}

// Ends the run, also before the page is connected.
function end() {
  ending = true;
  byId("state").textContent = "ending";
  byId("state").className = "state over";
  document.querySelectorAll("button").forEach((each) => { each.disabled = true; });
  if (socket.readyState === WebSocket.CONNECTING) socket.addEventListener("open", () => send("end"));
  else send("end");
}

// Shown in place of the picture once nothing more will come.
function showOver(words) {
  over = true;
  byId("over").textContent = words;
  byId("over").classList.add("shown");
  byId("state").textContent = "ended";
  byId("state").className = "state over";
  document.querySelectorAll("button, input, select").forEach((each) => { each.disabled = true; });
}

async function draw(bytes) {
  try {
    const image = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    picture.width = image.width;
    picture.height = image.height;
    picture.getContext("2d").drawImage(image, 0, 0);
    if (!over) byId("over").classList.remove("shown");
    image.close();
  } finally {
    send("seen");
  }
}

function reportSize() {
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  const wide = Math.round(picture.clientWidth * scale), tall = Math.round(picture.clientHeight * scale);
  if (wide >= 64 && tall >= 64) send("size", { wide: Math.min(wide, 8192), tall: Math.min(tall, 8192) });
}

// Calls `hello` with the first message and `news` with every other.
function listen(hello, news, over) {
  socket.addEventListener("message", (event) => {
    if (typeof event.data !== "string") return draw(event.data);
    const message = JSON.parse(event.data);
    if (message.hello) {
      reportSize();
      new ResizeObserver(reportSize).observe(picture);
      return hello(message.hello);
    }
    return news(message);
  });
  socket.addEventListener("close", (event) => {
    showOver(event.code === 4001 ? "Another page shows it now: close this one, or load it again." : over);
  });
}

// A drag turns the view where `turns` holds for its button and keys, and is handed to `move` elsewhere.
function takeMouse(turns, move, wheel) {
  let last = null, turning = false;
  picture.addEventListener("contextmenu", (event) => event.preventDefault());
  picture.addEventListener("pointerdown", (event) => {
    picture.setPointerCapture(event.pointerId);
    picture.focus();
    last = [event.clientX, event.clientY];
    turning = turns(event);
    event.preventDefault();
  });
  picture.addEventListener("pointermove", (event) => {
    if (last === null) return;
    const tall = picture.clientHeight;
    const share = (pixels) => Math.max(-4, Math.min(4, pixels / tall));
    const travel = { right: share(event.clientX - last[0]), up: share(last[1] - event.clientY) };
    last = [event.clientX, event.clientY];
    if (turning) send("turn", travel); else move(travel);
  });
  for (const name of ["pointerup", "pointercancel"]) picture.addEventListener(name, () => { last = null; });
  picture.addEventListener("wheel", (event) => {
    event.preventDefault();
    const by = event.deltaY || event.deltaX;  // with shift some systems turn the wheel sideways
    const notches = Math.max(-20, Math.min(20, event.deltaMode === 0 ? by / 100 : by / 3));
    if (notches !== 0) wheel(event, notches);
  }, { passive: false });
}

const zoom = (notches) => send("zoom", { by: Math.max(0.2, Math.min(5, Math.exp(-0.1 * notches))) });

function drawLegend(entries, change) {
  byId("legend").replaceChildren(...Object.entries(entries).map(([name, colour]) => {
    const line = document.createElement("li"), swatch = document.createElement("span");
    swatch.className = "swatch";
    swatch.style.background = colour;
    const holder = change ? document.createElement("label") : line;
    if (change) {
      const box = document.createElement("input");
      box.type = "checkbox";
      box.checked = !change.hidden.includes(name);
      box.addEventListener("change", () => send("layer", { name }));
      holder.append(box);
      line.append(holder);
    }
    holder.append(name, swatch);
    return line;
  }));
}

const fixed = (value, digits) => (Object.is(Math.round(value * 10 ** digits), -0) ? 0 : value).toFixed(digits);

const newtonMetres = (torque) => (torque >= 1 ? `${fixed(torque, 2)} N·m` : `${fixed(1000 * torque, 1)} mN·m`);

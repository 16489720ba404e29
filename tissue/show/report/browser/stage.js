// The run in 3D: vtk.js draws, this script gives its objects the shape, colours and places of the moment.

const EYE = [0.25, -0.75, 0.8], UP = [0, 0.35, 1];

// vtk.js's window, once it has made all of its objects from the empty scene.
async function windowOf(count) {
  for (let waited = 0; waited < 30000; waited += 30) {
    const found = window.renderWindow;
    const actors = found?.getRenderersByReference().at(-1)?.getActors() ?? [];
    const ready = (actor) => {
      const data = actor.getMapper()?.getInputData();
      return data?.getPointData().getScalars() && data.getPointData().getNormals() && data.getCellData().getScalars();
    };
    if (actors.length === count && actors.every(ready)) return found;
    await new Promise((next) => setTimeout(next, 30));
  }
  throw new Error("the 3D view did not start: it needs WebGL");
}

function turned(q, [x, y, z]) {
  const [a, b, c, w] = q;
  const t = [2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)];
  return [x + w * t[0] + b * t[2] - c * t[1], y + w * t[1] + c * t[0] - a * t[2], z + w * t[2] + a * t[1] - b * t[0]];
}

// Column-major matrix of three axes and a place.
const matrix = (x, y, z, place) => new Float64Array([...x, 0, ...y, 0, ...z, 0, ...place, 1]);

async function makeStage(stage, trace, moment) {
  const box = document.getElementById("stage");
  const shownWindow = await windowOf(stage.parts.length);
  const [empty, renderer] = shownWindow.getRenderersByReference();  // the viewer's own, and the one with our parts
  shownWindow.removeRenderer(empty);
  const camera = renderer.getActiveCamera();
  const parts = stage.parts.map((record, index) => makePart(record, renderer.getActors()[index]));
  const scales = stage.scales.map((scale, index) => ({ ...scale, key: index, table: Uint8Array.from(atob(scale.colours), (one) => one.charCodeAt(0)) }));
  const select = document.getElementById("scale");
  const open = document.getElementById("open");
  scales.forEach((scale, index) => select.add(new Option(`${scale.group === "bone" ? "bone: " : ""}${scale.label}${scale.unit ? ` / ${scale.unit}` : ""}`, index)));
  select.parentNode.hidden = scales.length < 2;
  open.checked = stage.open;
  const poses = stage.poses && {
    rows: stage.poses.rows,
    tool: numbers(stage.poses.tool),
    turns: numbers(stage.poses.turns),
    device: stage.poses.device && numbers(stage.poses.device),
  };
  const force = "xyz".split("").map((c) => trace && (trace.columns[`model_force_${c}_N`] ? numbers(trace.columns[`model_force_${c}_N`]) : new Float32Array(trace.rows)));
  const words = document.getElementById("stage-reading");
  let asked = false;

  const render = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      renderer.resetCameraClippingRange();
      shownWindow.render();
      drawScaleBar();
    });
  };

  function follow(time) {
    if (!poses) return;
    const row = Math.min(Math.max((time - trace.start_s) / trace.step_s, 0), trace.rows - 1);
    let low = 0, high = poses.rows.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (poses.rows[middle] <= row) low = middle;
      else high = middle;
    }
    const span = poses.rows[high] - poses.rows[low];
    const share = span ? (row - poses.rows[low]) / span : 0;
    const at = (values, k, width) => values[width * low + k] + share * (values[width * high + k] - values[width * low + k]);
    let q = [0, 1, 2, 3].map((k) => at(poses.turns, k, 4));
    q = q.map((one) => one / Math.hypot(...q));
    const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => turned(q, axis));
    const place = (values) => [0, 1, 2].map((k) => at(values, k, 3));
    const tip = place(poses.tool);
    const pushed = force.map((one) => one[Math.round(row)]);
    const size = Math.hypot(...pushed);
    for (const { record, actor } of parts) {
      if (record.follows === "tool") actor.setUserMatrix(matrix(...axes, tip));
      if (record.follows === "device") actor.setUserMatrix(matrix(...axes, place(poses.device)));
      if (record.follows === "force") {
        const shown = size > 1e-3 * Math.max(stage.force.largest_N, 1e-9);
        actor.setVisibility(shown);
        if (shown) actor.setUserMatrix(arrow(pushed.map((one) => one / size), (stage.force.longest_mm * size) / stage.force.largest_N, tip));
      }
    }
    words.textContent = `force ${size.toPrecision(3)} N`;
  }

  // The arrow along x, as long as its force is great and as thick as the longest one.
  function arrow(x, length, place) {
    const thick = Math.min(1, Math.max(length / stage.force.longest_mm, 0.4)) * stage.force.longest_mm;
    const other = Math.abs(x[2]) < 0.9 ? [0, 0, 1] : [0, 1, 0];
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const y = cross(other, x).map((one, _, all) => one / Math.hypot(...all));
    const z = cross(x, y);
    return matrix(x.map((one) => length * one), y.map((one) => thick * one), z.map((one) => thick * one), place);
  }

  function show(time) {
    const scale = scales[select.value || 0];
    const fields = parts.some(({ record }) => record.open);
    open.parentNode.hidden = !fields || scale?.group !== "field";
    for (const part of parts) {
      const { record, actor } = part;
      if (record.group) {
        const visible = record.group === scale.group && (record.open === undefined || record.open === open.checked);
        actor.setVisibility(visible);
        if (!visible) continue;
      }
      part.show(time, scale);
    }
    follow(time);
    render();
  }

  function legend() {
    const scale = scales[select.value || 0];
    const shown = document.getElementById("legend");
    shown.replaceChildren();
    if (scale?.names) {
      for (const [name, colour] of scale.names) {
        const key = shown.appendChild(document.createElement("span"));
        key.className = "key fill";
        key.style.setProperty("--key", colour);
        key.textContent = name;
      }
    } else if (scale) {
      const digits = (value) => Number(value.toPrecision(3)).toString();
      const add = (text) => (shown.appendChild(document.createElement("span")).textContent = text);
      const stops = [...Array(17).keys()].map((k) => 3 * Math.round((k * 255) / 16)).map((at) => `rgb(${scale.table.slice(at, at + 3).join(",")})`);
      add(`${scale.label}${scale.unit ? ` / ${scale.unit}` : ""}${scale.logarithmic ? ", logarithmic" : ""}`);
      add(digits(scale.low));
      const bar = shown.appendChild(document.createElement("span"));
      bar.className = "bar";
      bar.style.background = `linear-gradient(to right, ${stops.join(",")})`;
      add(digits(scale.high));
    }
    for (const { record } of parts.filter((one) => one.record.label)) {
      const key = shown.appendChild(document.createElement("span"));
      key.className = record.line ? "key" : "key fill";
      key.style.setProperty("--key", record.colour);
      key.textContent = record.label;
    }
  }

  function reset() {
    const [low, high] = stage.bounds[scales[select.value || 0]?.group ?? ""];
    const middle = low.map((one, k) => 0.5 * (one + high[k]));
    const size = Math.hypot(...low.map((one, k) => high[k] - one)) || 1;
    camera.setParallelProjection(true);
    camera.setFocalPoint(...middle);
    camera.setPosition(...middle.map((one, k) => one + 3 * size * EYE[k]));
    camera.setViewUp(...UP);
    camera.orthogonalizeViewUp?.();
    const view = camera.getViewMatrix();
    let wide = 0, tall = 0;
    for (let corner = 0; corner < 8; corner++) {
      const d = [0, 1, 2].map((k) => ((corner >> k) & 1 ? high[k] : low[k]) - middle[k]);
      wide = Math.max(wide, Math.abs(view[0] * d[0] + view[1] * d[1] + view[2] * d[2]));
      tall = Math.max(tall, Math.abs(view[4] * d[0] + view[5] * d[1] + view[6] * d[2]));
    }
    camera.setParallelScale(1.08 * Math.max(tall, (wide * box.clientHeight) / box.clientWidth));
    render();
  }

  // A bar of a round length, and the axes as the camera sees them.
  function drawScaleBar() {
    const perMm = box.clientHeight / (2 * camera.getParallelScale());
    const power = 10 ** Math.floor(Math.log10(120 / perMm));
    const length = [5, 2, 1].map((one) => one * power).find((one) => one * perMm <= 120);
    document.getElementById("bar").style.width = `${length * perMm}px`;
    document.getElementById("bar-length").textContent = `${length} mm`;
    const view = camera.getViewMatrix();
    document.querySelectorAll("#axes line").forEach((line, k) => {
      const [x, y] = [26 * view[k], -26 * view[4 + k]];
      line.setAttribute("x2", x);
      line.setAttribute("y2", y);
      const name = document.querySelectorAll("#axes text")[k];
      name.setAttribute("x", 1.35 * x);
      name.setAttribute("y", 1.35 * y + 4);
    });
  }

  const theme = () => {
    const [r, g, b] = getComputedStyle(document.documentElement).getPropertyValue("--stage").split(",").map(Number);
    renderer.setBackground(r / 255, g / 255, b / 255);
    render();
  };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", theme);
  let group = scales[0]?.group;
  select.addEventListener("change", () => {
    legend();
    show(moment.time);
    if (scales[select.value].group !== group) reset();
    group = scales[select.value].group;
  });
  open.addEventListener("change", () => show(moment.time));
  document.getElementById("reset").addEventListener("click", reset);
  camera.onModified(() => requestAnimationFrame(drawScaleBar));
  moment.listen(show);
  legend();
  theme();
  reset();
  box.dataset.ready = "true";
}

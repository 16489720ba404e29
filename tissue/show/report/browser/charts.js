// Charts over time: the wheel zooms, a drag takes a span, a click goes to the moment, a double click shows all.

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 64, RIGHT = 10, TOP = 8, BOTTOM = 22;

function element(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return parent.appendChild(made);
}

function ticks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough * (1 - 1e-9));
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
    found.push([k * step, (k * step + 0).toFixed(digits).replace(/^-(0(\.0+)?)$/, "$1")]);
  }
  return found;
}

function makeCharts(trace, charts, events, moment) {
  const cache = {};
  const zero = new Float32Array(trace.rows);
  const column = (name) => (cache[name] ??= name in trace.columns ? numbers(trace.columns[name]) : zero);
  const layer = whole(trace.layer);
  const last = Math.max(trace.rows - 1, 1);
  const view = { from: 0, to: last };  // rows
  const timeOf = (row) => trace.start_s + trace.step_s * row;
  const values = (line) => (line.values ??= valuesOf(line));
  const valuesOf = (line) => {
    const scale = line.scale;
    const parts = line.of.map(column);
    if (parts.length === 1) return parts[0].map((one) => scale * one);
    return parts[0].map((_, row) => scale * Math.hypot(...parts.map((part) => part[row])));
  };
  const panels = charts.map((chart) => makePanel(chart));
  const readout = document.getElementById("reading");

  function makePanel(chart) {
    const box = document.getElementById("charts").appendChild(document.createElement("figure"));
    const head = box.appendChild(document.createElement("figcaption"));
    head.append(chart.label);
    if (chart.choose) {
      const select = document.createElement("select");
      select.setAttribute("aria-label", "column of the trace");
      for (const [name, label] of Object.entries(trace.labels)) select.add(new Option(label, name, false, name === chart.choose));
      select.addEventListener("change", () => {
        chart.lines = [{ of: [select.value], label: "", colour: "", scale: 1 }];
        draw();
      });
      head.replaceChildren(select);
    }
    for (const line of chart.lines.filter((one) => one.label)) {
      const key = head.appendChild(document.createElement("span"));
      key.className = line.fill ? "key fill" : "key";
      key.style.setProperty("--key", line.colour || "var(--ink)");
      key.textContent = line.label;
    }
    if (chart.lines.some((one) => one.pale)) head.append(Object.assign(document.createElement("span"), { className: "soft", textContent: "pale: as commanded, low-passed" }));
    if (chart.layers) {
      const met = new Set(layer);
      trace.layers.forEach(([name, colour], index) => {
        if (!met.has(index)) return;
        const key = head.appendChild(document.createElement("span"));
        key.className = "key fill";
        key.style.setProperty("--key", colour);
        key.textContent = `largest contact: ${name}`;
      });
    }
    const svg = element("svg", { height: chart.tall ? 220 : 130 }, box);
    listen(svg);
    return { chart, svg };
  }

  const place = (row, width) => LEFT + ((row - view.from) / (view.to - view.from)) * (width - LEFT - RIGHT);
  const rowAt = (x, width) => view.from + ((x - LEFT) / (width - LEFT - RIGHT)) * (view.to - view.from);

  // Highest and lowest of every pixel's rows, or all rows where there are fewer.
  function outline(line, first, end, x, y, width) {
    const all = values(line);
    const size = Math.max(1, (end - first) / (2 * width));
    const path = [];
    if (size <= 1) for (let row = first; row <= end; row++) path.push([x(row), y(all[row])]);
    else
      for (let bin = first; bin <= end; bin += size) {
        let low = Infinity, high = -Infinity;
        for (let row = Math.floor(bin); row < Math.min(bin + size, end + 1); row++) {
          low = Math.min(low, all[row]);
          high = Math.max(high, all[row]);
        }
        path.push([x(bin), y(low)]);
        if (high > low) path.push([x(bin), y(high)]);
      }
    return path.map(([a, b]) => `${a.toFixed(1)},${b.toFixed(1)}`).join("L");
  }

  function drawPanel({ chart, svg }, isLast) {
    const width = svg.clientWidth || 600;
    const height = svg.clientHeight || 130;
    svg.replaceChildren();
    const first = Math.max(Math.floor(view.from), 0);
    const end = Math.min(Math.ceil(view.to), trace.rows - 1);
    let low = 0, high = 0;
    for (const line of chart.lines) {
      const all = values(line);
      for (let row = first; row <= end; row++) {
        if (all[row] < low) low = all[row];
        if (all[row] > high) high = all[row];
      }
    }
    if (high - low < 1e-9) high = low + 1;
    const margin = 0.05 * (high - low);
    const y = (value) => TOP + ((high + margin - value) / (high - low + 2 * margin)) * (height - TOP - BOTTOM);
    const x = (row) => place(row, width);
    const clip = `clip-${panels ? panels.findIndex((one) => one.svg === svg) : 0}`;
    element("rect", { x: LEFT, y: 0, width: width - LEFT - RIGHT, height: height - BOTTOM },
      element("clipPath", { id: clip }, element("defs", {}, svg)));
    const plot = element("g", { "clip-path": `url(#${clip})` }, svg);
    if (chart.layers) drawLayers(plot, first, end, x, height);
    for (const [value, words] of ticks(low - margin, high + margin, chart.tall ? 6 : 3)) {
      element("line", { x1: LEFT, x2: width - RIGHT, y1: y(value), y2: y(value), class: value === 0 ? "zero" : "grid" }, svg);
      element("text", { x: LEFT - 6, y: y(value) + 4, "text-anchor": "end" }, svg).textContent = words;
    }
    for (const [time, words] of ticks(timeOf(view.from), timeOf(view.to), Math.max(width / 110, 2))) {
      const at = x((time - trace.start_s) / trace.step_s);
      element("line", { x1: at, x2: at, y1: height - BOTTOM, y2: height - BOTTOM + 4, class: "zero" }, svg);
      element("text", { x: at, y: height - BOTTOM + 16, "text-anchor": "middle" }, svg).textContent = isLast ? `${words} s` : words;
    }
    for (const line of chart.lines) {
      const path = outline(line, first, end, x, y, width);
      const look = line.fill ? { d: `M${x(first)},${y(0)}L${path}L${x(end)},${y(0)}Z`, class: "fill" }
        : { d: `M${path}`, class: line.pale ? "pale" : "line" };
      element("path", look, plot).style.stroke = line.fill ? "none" : line.colour || "var(--ink)";
    }
    events.forEach((event, index) => {
      const at = x((event.time_s - trace.start_s) / trace.step_s);
      element("line", { x1: at, x2: at, y1: 0, y2: height - BOTTOM, class: "event" }, plot);
      if (svg === panels[0].svg) element("text", { x: at + 3, y: 10 + 11 * (index % 3), class: "event" }, plot).textContent = index + 1;
    });
    svg.cursor = element("line", { y1: 0, y2: height - BOTTOM, class: "cursor" }, plot);
    placeCursor(svg, moment.time);
  }

  function drawLayers(plot, first, end, x, height) {
    for (let row = first; row <= end; ) {
      let stop = row;
      while (stop <= end && layer[stop] === layer[row]) stop++;
      if (layer[row] >= 0) {
        element("rect", { x: x(row), y: 0, width: Math.max(x(stop) - x(row), 0.5), height: height - BOTTOM, fill: trace.layers[layer[row]][1], opacity: 0.35 }, plot);
      }
      row = stop;
    }
  }

  function placeCursor(svg, time) {
    const at = place((time - trace.start_s) / trace.step_s, svg.clientWidth || 600);
    svg.cursor?.setAttribute("x1", at);
    svg.cursor?.setAttribute("x2", at);
  }

  function read(row) {
    const words = [`${timeOf(row).toFixed(3)} s`];
    for (const { chart, svg } of panels) {
      const [name, unit] = chart.label.split(" / ");
      const lines = chart.lines.filter((one) => !one.pale);
      const one = chart.choose ? svg.parentNode.querySelector("select").selectedOptions[0].text.split(" / ") : [name, unit];
      words.push(`${one[0]} ${lines.map((line) => `${line.label && line.label !== "magnitude" ? `${line.label} ` : ""}${Number(values(line)[row].toPrecision(4))}`).join(", ")} ${one[1] ?? ""}`);
    }
    readout.textContent = words.join(" · ");
  }

  function draw() {
    panels.forEach((panel, index) => drawPanel(panel, index === panels.length - 1));
    read(Math.min(Math.max(Math.round((moment.time - trace.start_s) / trace.step_s), 0), trace.rows - 1));
  }

  function show(from, to) {
    const span = Math.min(Math.max(to - from, 8), last);
    view.from = Math.min(Math.max(0.5 * (from + to - span), 0), last - span);
    view.to = view.from + span;
    draw();
  }

  function listen(svg) {
    let begin = null;
    const at = (event) => event.clientX - svg.getBoundingClientRect().left;
    const row = (event) => Math.min(Math.max(rowAt(at(event), svg.clientWidth), view.from), view.to);
    svg.addEventListener("wheel", (event) => {
      const out = event.deltaY > 0;
      if (out && view.to - view.from >= last) return;  // all is shown: the page scrolls
      event.preventDefault();
      const factor = Math.exp(0.002 * event.deltaY), middle = row(event);
      show(middle - factor * (middle - view.from), middle + factor * (view.to - middle));
    }, { passive: false });
    svg.addEventListener("pointerdown", (event) => {
      begin = { x: at(event), row: row(event) };
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      if (trace.rows) read(Math.min(Math.max(Math.round(row(event)), 0), trace.rows - 1));
      if (begin === null || Math.abs(at(event) - begin.x) < 4) return;
      svg.span ??= element("rect", { y: 0, height: svg.clientHeight - BOTTOM, class: "span" }, svg);
      svg.span.setAttribute("x", Math.min(at(event), begin.x));
      svg.span.setAttribute("width", Math.abs(at(event) - begin.x));
    });
    svg.addEventListener("pointerup", (event) => {
      if (begin !== null && svg.span) show(Math.min(begin.row, row(event)), Math.max(begin.row, row(event)));
      else if (begin !== null) moment.to(timeOf(row(event)));
      svg.span = begin = null;
    });
    svg.addEventListener("pointercancel", () => { svg.span?.remove(); svg.span = begin = null; });
    svg.addEventListener("dblclick", () => show(0, last));
  }

  moment.listen((time) => {
    panels.forEach(({ svg }) => placeCursor(svg, time));
    read(Math.min(Math.max(Math.round((time - trace.start_s) / trace.step_s), 0), trace.rows - 1));
  });
  document.getElementById("all").addEventListener("click", () => show(0, last));
  new ResizeObserver(draw).observe(document.getElementById("charts"));
  draw();
}

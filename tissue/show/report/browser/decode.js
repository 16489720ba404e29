// Reads what tissue/show/report/charts.py writes.

async function inflate(text) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Replaces the text of every packed array below a record by its bytes.
async function inflateAll(record) {
  const waiting = [];
  const visit = (one) => {
    if (one === null || typeof one !== "object") return;
    if (typeof one.data === "string" && "kind" in one) {
      waiting.push(inflate(one.data).then((bytes) => { one.data = bytes; }));
    } else {
      Object.values(one).forEach(visit);
    }
  };
  visit(record);
  await Promise.all(waiting);
}

const KINDS = { u1: Uint8Array, i2: Int16Array, i4: Int32Array };

// Whole numbers of a packed array, row by row.
function whole({ rows, columns, kind, data }) {
  const steps = new KINDS[kind](data.buffer);
  const values = new KINDS[kind](rows * columns);
  for (let column = 0; column < columns; column++) {
    for (let row = 0; row < rows; row++) {
      const at = row * columns + column;
      values[at] = steps[column * rows + row] + (row ? values[at - columns] : 0);
    }
  }
  return values;
}

// Numbers of a quantised array, row by row.
function numbers(packed) {
  const values = Float32Array.from(whole(packed));
  const { columns, low, step } = packed;
  for (let i = 0; i < values.length; i++) values[i] = low[i % columns] + step * (values[i] + 32767);
  return values;
}

// Points and triangles of a surface.
function surface(mesh) {
  return { points: numbers(mesh.points), corners: Uint32Array.from(whole(mesh.corners)) };
}

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

// Whole numbers of a packed array, row by row.
function whole(packed) {
  const { rows, columns, data } = packed;
  const size = Number(packed.kind.slice(1));
  const count = rows * columns;
  const shift = 32 - 8 * size;
  const values = new Int32Array(count);
  for (let column = 0; column < columns; column++) {
    let last = 0;
    for (let row = 0; row < rows; row++) {
      let value = 0;
      for (let plane = 0; plane < size; plane++) {
        value |= data[plane * count + column * rows + row] << (8 * plane);
      }
      if (packed.differences) last += (value >>> 1) ^ -(value & 1);
      else last = value;
      last = packed.kind[0] === "u" ? (last << shift) >>> shift : (last << shift) >> shift;
      values[row * columns + column] = last;
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
  const codes = whole(mesh.corners);
  const corners = new Uint32Array(codes.length);
  let unnamed = 0;
  for (let i = 0; i < codes.length; i++) {
    corners[i] = unnamed - codes[i];
    if (codes[i] === 0) unnamed++;
  }
  return { points: numbers(mesh.points), corners };
}

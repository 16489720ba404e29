// A part of the 3D view: a surface or a line of vtk.js that takes the shape and colours of a moment.

// Normals at points, averaged over neighbours that agree, so that one sees the bone and not its voxels.
function normalsOf(points, corners, passes) {
  let normals = new Float32Array(points.length);
  const sub = (a, b, k) => points[3 * a + k] - points[3 * b + k];
  for (let t = 0; t < corners.length; t += 3) {
    const [a, b, c] = [corners[t], corners[t + 1], corners[t + 2]];
    const x = sub(b, a, 1) * sub(c, a, 2) - sub(b, a, 2) * sub(c, a, 1);
    const y = sub(b, a, 2) * sub(c, a, 0) - sub(b, a, 0) * sub(c, a, 2);
    const z = sub(b, a, 0) * sub(c, a, 1) - sub(b, a, 1) * sub(c, a, 0);
    for (const i of [a, b, c]) {
      normals[3 * i] += x;
      normals[3 * i + 1] += y;
      normals[3 * i + 2] += z;
    }
  }
  const unit = (one) => {
    for (let i = 0; i < one.length; i += 3) {
      const size = Math.hypot(one[i], one[i + 1], one[i + 2]) || 1;
      one[i] /= size;
      one[i + 1] /= size;
      one[i + 2] /= size;
    }
    return one;
  };
  unit(normals);
  for (let pass = 0; pass < passes; pass++) {
    const sum = normals.slice();
    for (let t = 0; t < corners.length; t++) {
      const a = 3 * corners[t], b = 3 * corners[t % 3 === 2 ? t - 2 : t + 1];
      const agree = normals[a] * normals[b] + normals[a + 1] * normals[b + 1] + normals[a + 2] * normals[b + 2];
      if (agree < 0.8) continue;
      for (let k = 0; k < 3; k++) {
        sum[a + k] += agree * normals[b + k];
        sum[b + k] += agree * normals[a + k];
      }
    }
    normals = unit(sum);
  }
  return normals;
}

function makePart(record, actor) {
  const data = actor.getMapper().getInputData();
  const mapper = actor.getMapper();
  const meshes = {};
  const arrays = {};
  const kept = (key, make) => (arrays[key] ??= make());
  let drawn = "";
  mapper.setColorModeToDirectScalars?.();
  mapper.setScalarVisibility(false);
  const look = actor.getProperty();
  look.setAmbient(0.25);
  look.setDiffuse(0.8);
  look.setSpecular(0.08);
  if (!record.smooth) look.setInterpolationToFlat();
  if (record.colour) look.setColor(...[1, 3, 5].map((at) => parseInt(record.colour.slice(at, at + 2), 16) / 255));
  if (record.opacity) look.setOpacity(record.opacity);
  if (record.follows) {  // behind the surface that it cuts, with which it would flicker
    mapper.setResolveCoincidentTopology?.(1);
    mapper.setRelativeCoincidentTopologyPolygonOffsetParameters?.(0, 150);
  }

  if (record.line) {
    const points = numbers(record.line);
    data.getPoints().setData(points, 3);
    data.getLines().setData(Uint32Array.from([points.length / 3, ...Array(points.length / 3).keys()]));
    look.setLineWidth(2);
    look.setLighting(false);
    data.modified();
    return { record, actor, show: () => {} };
  }

  function mesh(index) {
    if (index in meshes) return meshes[index];
    const made = surface(record.meshes[index]);
    const count = made.corners.length / 3;
    made.cells = new Uint32Array(4 * count);
    for (let t = 0; t < count; t++) made.cells.set([3, made.corners[3 * t], made.corners[3 * t + 1], made.corners[3 * t + 2]], 4 * t);
    if (record.smooth) made.normals = normalsOf(made.points, made.corners, record.group === "bone" ? 6 : 0);
    return (meshes[index] = made);
  }

  // Frame at a time, the next one of the same mesh and how far it lies between them.
  function between(time) {
    let index = 0;
    while (index + 1 < record.times.length && record.times[index + 1] <= time + 1e-9) index++;
    const next = Math.min(index + 1, record.frames.length - 1);
    const same = record.blend && next > index && record.frames[next].mesh === record.frames[index].mesh;
    const share = same ? Math.min(Math.max((time - record.times[index]) / (record.times[next] - record.times[index]), 0), 1) : 0;
    return { index, next: share ? next : index, share };
  }

  function mixed(name, read, { index, next, share }) {
    const early = kept(`${name} ${index}`, () => read(record.frames[index][name]));
    if (!share) return early;
    const late = kept(`${name} ${next}`, () => read(record.frames[next][name]));
    return early.map((one, at) => one + share * (late[at] - one));
  }

  function shape(at) {
    const made = mesh(record.frames[at.index].mesh);
    let points = made.points;
    if (record.frames[at.index].moved) {
      const moved = mixed("moved", numbers, at);
      points = points.map((one, place) => one + moved[place]);
    }
    data.getPoints().setData(points, 3);
    data.getPolys().setData(made.cells);
    data.getPointData().getNormals().setData(made.normals ?? new Float32Array(points.length), 3);
    return made;
  }

  function colour(scale, at, made) {
    const values = scale.array in record.frames[at.index] ? mixed(scale.array, (one) => Float32Array.from(whole(one)), at) : null;
    const count = scale.on === "cells" ? made.corners.length / 3 : made.points.length / 3;
    const colours = new Uint8Array(3 * count);
    for (let i = 0; i < count; i++) {
      const entry = 3 * (values ? Math.round(values[i]) : 0);
      colours.set(scale.table.subarray(entry, entry + 3), 3 * i);
    }
    const kind = scale.on === "cells" ? data.getCellData() : data.getPointData();
    kind.getScalars().setData(colours, 3);
    mapper.setScalarMode(scale.on === "cells" ? 2 : 1);
    mapper.setScalarVisibility(true);
  }

  return {
    record,
    actor,
    show(time, scale) {
      const at = between(time);
      const key = `${at.index} ${at.share} ${record.group ? scale?.key : ""}`;
      if (key === drawn) return;
      drawn = key;
      const made = shape(at);
      if (record.group && scale) colour(scale, at, made);
      data.modified();
    },
  };
}

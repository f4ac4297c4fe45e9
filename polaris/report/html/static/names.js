// Names in the scene: annotations beside what they name, clear of each other in a window of any width.

const TYPE = 12, HIGH = 15, NEAR = 6; // size of type, height of a name, distance from what it names [px]
const SIDES = [[0, -1], [0, 1], [1, 0], [-1, 0], [1, -1], [1, 1], [-1, -1], [-1, 1]], RINGS = 12;
const ruler = document.createElement("canvas").getContext("2d");

// A function from a point of the scene to its place in the drawing, from the upper left corner [px].
function projection(scene, data) {
  const full = scene._fullLayout, { space, range } = data.scene;
  if (space === 2) return (p) => [full.xaxis, full.yaxis].map((axis, k) => axis._offset + axis.d2p(p[k]));
  const { camera, aspectratio } = full.scene, list = (v) => [v.x, v.y, v.z];
  const dot = (a, b) => a.reduce((sum, v, k) => sum + v * b[k], 0), unit = (a) => a.map((v) => v / Math.sqrt(dot(a, a)));
  const cross = (a, b) => [0, 1, 2].map((k) => a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
  const eye = list(camera.eye), ratio = list(aspectratio), ahead = unit(list(camera.center).map((v, k) => v - eye[k]));
  const right = unit(cross(ahead, list(camera.up))), up = cross(right, ahead), scale = full.height / 2 / HALF;
  return (p) => {
    const ray = p.map((v, k) => ((v - range[k][0]) / (range[k][1] - range[k][0]) - 0.5) * ratio[k] - eye[k]), depth = dot(ray, ahead);
    return [full.width / 2 + scale * dot(ray, right) / depth, full.height / 2 - scale * dot(ray, up) / depth];
  };
}

// The part of the drawing in which names may stand: left, top, right and bottom [px].
function frameOf(scene, data) {
  const { width, height, xaxis, yaxis } = scene._fullLayout;
  if (data.scene.space === 3) return [0, 0, width, height];
  return [xaxis._offset, yaxis._offset, xaxis._offset + xaxis._length, yaxis._offset + yaxis._length];
}

// Annotations of names, each at the nearest place that no other name, no button and no `marks` take; a line leads to one
// that stands apart. A name without a place, or of what is out of view, is left out: pointing at the thing tells it.
function annotationsOf(scene, data, names, marks) {
  const at = projection(scene, data), [left, top, right, bottom] = frameOf(scene, data), box = scene.getBoundingClientRect();
  const taken = marks.map((p) => [...at(p), NEAR, NEAR]);
  const bar = scene.querySelector(".modebar");
  if (bar) {
    const r = bar.getBoundingClientRect();
    taken.push([(r.left + r.right) / 2 - box.left, (r.top + r.bottom) / 2 - box.top, r.width / 2, r.height / 2]);
  }
  ruler.font = `${TYPE}px system-ui, sans-serif`;
  return names.flatMap(({ text, colour, p, below }) => {
    const [x, y] = at(p), w = ruler.measureText(text).width / 2 + 2, h = HIGH / 2;
    if (!(x >= left && x <= right && y >= top && y <= bottom)) return [];
    for (let ring = 0; ring < RINGS; ring++) {
      for (const [i, j] of SIDES) {
        const cx = Math.min(Math.max(x + i * (w + NEAR + ring * HIGH), left + w), right - w);
        const cy = y + (below ? -j : j) * (h + NEAR + ring * HIGH);
        if (cy < top + h || cy > bottom - h || taken.some(([a, b, c, d]) => Math.abs(cx - a) < w + c && Math.abs(cy - b) < h + d)) continue;
        if (Math.abs(cx - x) < w && Math.abs(cy - y) < h) continue;
        taken.push([cx, cy, w, h]);
        return [{ ...Object.fromEntries(p.map((v, k) => ["xyz"[k], v])), text: plain(text), ax: cx - x, ay: cy - y, xanchor: "center", yanchor: "middle",
          font: { size: TYPE, color: colour }, bgcolor: "rgba(255,255,255,0.6)", borderpad: 0, showarrow: true, arrowhead: 0, arrowwidth: 1,
          arrowcolor: ring ? colour : "rgba(0,0,0,0)", captureevents: false }];
      }
    }
    return [];
  });
}

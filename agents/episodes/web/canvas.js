
// Drawing on a 2-D canvas, and the close-up of the estimates about the truth.

function sized(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2), width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const paper = canvas.getContext("2d");
  paper.setTransform(ratio, 0, 0, ratio, 0, 0);
  paper.clearRect(0, 0, width, height);
  paper.lineJoin = "round"; paper.font = "11px system-ui, sans-serif";
  return { paper, width, height };
}
/** Draw a line, or an area where it has a fill, with a closed outline. */
function draw(paper, points, { stroke, width = 1.5, dash = [], fill, alpha = 1 }) {
  paper.beginPath();
  points.forEach(([x, y], i) => (i ? paper.lineTo(x, y) : paper.moveTo(x, y)));
  if (fill) { paper.closePath(); paper.globalAlpha = alpha; paper.fillStyle = fill; paper.fill(); paper.globalAlpha = 1; }
  if (stroke) { paper.setLineDash(dash); paper.strokeStyle = stroke; paper.lineWidth = width; paper.stroke(); paper.setLineDash([]); }
}
/** Text with a halo, so that it can be read on lines too. */
function write(paper, text, x, y, align = "left", colour = colours.muted) {
  paper.textAlign = align; paper.lineWidth = 3; paper.strokeStyle = colours.water; paper.strokeText(text, x, y);
  paper.fillStyle = colour; paper.fillText(text, x, y);
}
function cross(paper, [x, y], r, width, alpha, stroke = colours.measurement) {
  paper.globalAlpha = alpha;
  for (const s of [1, -1]) draw(paper, [[x - r, y - s * r], [x + r, y + s * r]], { stroke, width });
  paper.globalAlpha = 1;
}
const TURN = Array.from({ length: 49 }, (_, i) => [Math.cos((i * Math.PI) / 24), Math.sin((i * Math.PI) / 24)]);
const circle = ([x, y], r) => TURN.map(([a, b]) => [x + r * a, y + r * b]);
/** Outline, relative to its centre, of twice the standard deviation in a plane; `flat` projects components on it. */
function ellipse(flight, time, flat) {
  const L = between(flight.root, time), columns = focus.map((_, c) => flat(focus.map((__, r) => L[r * k + c])));
  const [xx, xy, yy] = [[0, 0], [0, 1], [1, 1]].map(([a, b]) => columns.reduce((sum, column) => sum + column[a] * column[b], 0));
  const x = Math.sqrt(Math.max(xx, 1e-18)), tilt = xy / x, y = Math.sqrt(Math.max(yy - tilt * tilt, 0));
  return TURN.map(([a, b]) => [2 * x * a, 2 * (tilt * a + y * b)]);
}

function closeUp(time) {
  const { paper, width, height } = sized(element("belief")), fix = lastFix(flights[state.first], time);
  const parts = shown().map(({ flight, look }) => ({ flight, look, error: between(flight.error, time), L: flight.root ? between(flight.root, time) : new Array(k * k).fill(0) }));
  (k === 1 ? bell : target)(paper, width, height, parts.reverse(), time, fix);
}
/** Which way the second component of the close-up grows, in pixels: depth downwards, all else upwards. */
const DOWN = focus[1]?.axis[2] > 0 ? 1 : -1;
function target(paper, width, height, parts, time, fix) {
  const far = ({ error, L }) => Math.max(Math.abs(error[0]) + 2 * L[0], Math.abs(error[1]) + 2 * Math.hypot(L[k], L[k + 1]));
  const reach = round125(Math.max(1.05 * Math.max(...parts.map(far)), 1e-3));
  const cx = width / 2, cy = height / 2, scale = (Math.min(width, height) / 2 - 12) / reach, edge = { stroke: colours.edge, width: 1 };
  const at = ([a, b]) => [cx + a * scale, cy + DOWN * b * scale];
  for (const r of [0.5, 1]) draw(paper, circle([cx, cy], r * reach * scale), edge);
  draw(paper, [at([-reach, 0]), at([reach, 0])], edge);
  draw(paper, [at([0, -reach]), at([0, reach])], edge);
  paper.fillStyle = colours.muted; paper.textAlign = "left";
  paper.fillText(`${number(reach)} ${focus[0].unit}`, cx + 4, cy - reach * scale + 1);
  for (const { flight, look, error } of parts) {
    if (flight.root) draw(paper, ellipse(flight, time, (off) => off.slice(0, 2)).map(([a, b]) => at([error[0] + a, error[1] + b])), { fill: colours[look.band], stroke: colours[look.colour], width: 1.2, dash: look.dash });
    for (const off of cloud(flight, time)) draw(paper, circle(at([error[0] + off[0], error[1] + off[1]]), 1.8), { fill: colours[look.member] });
  }
  if (fix) {
    const distance = Math.hypot(fix.off[0], fix.off[1]) / reach, alpha = Math.max(0.2, 1 - fix.age / 4);
    if (distance <= 1) cross(paper, at(fix.off), 4.5, 2, alpha);
    else { // beyond the rim: an arrow that points to it
      const tip = at([fix.off[0] / distance, fix.off[1] / distance]), angle = Math.atan2(tip[1] - cy, tip[0] - cx);
      const fin = (turn) => [tip[0] - 8 * Math.cos(angle + turn), tip[1] - 8 * Math.sin(angle + turn)];
      paper.globalAlpha = alpha; draw(paper, [fin(0.5), tip, fin(-0.5)], { stroke: colours.measurement, width: 2 }); paper.globalAlpha = 1;
    }
  }
  draw(paper, circle([cx, cy], 4.5), { fill: colours.true });
  for (const { look, error } of parts) draw(paper, circle(at(error), 3.5), { fill: colours[look.colour] });
}
function bell(paper, width, height, parts, time, fix) {
  const base = height - 24, reach = round125(Math.max(...parts.map(({ error, L }) => Math.abs(error[0]) + 3 * L[0]), fix ? Math.abs(fix.off[0]) : 0, 1e-3));
  const x = (v) => width / 2 + (v / reach) * (width / 2 - 12), post = (v, high) => [[x(v), base], [x(v), high]];
  draw(paper, [[8, base], [width - 8, base]], { stroke: colours.edge, width: 1 });
  paper.fillStyle = colours.muted; paper.textAlign = "center";
  for (const v of [-reach, 0, reach]) paper.fillText(`${v > 0 ? "+" : ""}${number(v)}${focus[0].unit}`, Math.max(18, Math.min(width - 18, x(v))), height - 8);
  for (const { flight, look, error: [error], L: [sd] } of parts) {
    if (sd > 0) {
      const curve = Array.from({ length: 81 }, (_, i) => (i - 40) / 10).map((z) => [x(error + z * sd), base - (base - 26) * Math.exp(-0.5 * z * z)]);
      draw(paper, curve, { fill: colours[look.band], stroke: colours[look.colour], dash: look.dash });
    }
    for (const [off] of cloud(flight, time)) draw(paper, post(error + off, base - 14), { stroke: colours[look.member], width: 1 });
    draw(paper, post(error, 18), { stroke: colours[look.colour], width: 2 });
  }
  draw(paper, post(0, 10), { stroke: colours.true, width: 2 });
  if (fix) cross(paper, [x(fix.off[0]), base - 30], 4.5, 2, Math.max(0.2, 1 - fix.age / 4));
}

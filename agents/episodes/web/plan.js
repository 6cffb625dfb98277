
// Views from above and from the side, to scale, on a 2-D canvas.

const extent = scene && { low: scene.low, high: scene.high, middle: scene.low.map((v, j) => (v + scene.high[j]) / 2), span: Math.max(...scene.low.map((v, j) => scene.high[j] - v), 4 * scene.size, 1) };
/** Room at the right of a view, for the close-up that lies over a wide one, and at its top, for the buttons. */
const aside = () => [getComputedStyle(element("close")).position === "absolute" ? element("close").offsetWidth : 0, 46];
/** Level direction from the path's start to its end, as north and east. */
function alongPath() {
  const line = scene?.path.rows > 1 ? scene.path : flights[0].true, a = row(line, 0), b = row(line, line.rows - 1);
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
  return length > 0 ? [(b[0] - a[0]) / length, (b[1] - a[1]) / length] : [1, 0];
}

class Plan {
  constructor(canvas) {
    this.canvas = canvas;
    const way = alongPath(), above = { flat: ([n, e]) => [e, n], names: ["east", "north"], above: true };
    const side = { flat: ([n, e, d]) => [n * way[0] + e * way[1], -d], names: [way[1] === 0 ? "north" : "along the path", HEIGHT.word], above: false };
    this.views = [...(WIDE || !scene.space ? [above] : []), ...(scene.space ? [side] : [])];
    const ends = [...rows(scene.path), ...flights.flatMap((f) => rows(f.true)), ...(scene.goal ? [scene.goal] : [])];
    const rims = rows(scene.obstacles).flatMap(([n, e, r]) => [[n - r, e - r, ends[0][2]], [n + r, e + r, ends[0][2]]]);
    for (const view of this.views) {
      const flat = [...ends, ...(view.above ? rims : [])].map(view.flat);
      if (!view.above && scene.surface !== null) flat.push([flat[0][0], -scene.surface]);
      view.low = [0, 1].map((c) => Math.min(...flat.map((p) => p[c]))); view.high = [0, 1].map((c) => Math.max(...flat.map((p) => p[c])));
    }
  }
  draw(time) {
    const { paper, width, height } = sized(this.canvas), [right, top] = aside(), each = (height - top) / this.views.length;
    this.views.forEach((view, i) => {
      const box = { x: 0, y: i === 0 ? 0 : top + i * each, width, height: i === 0 ? top + each : each, right, top: i === 0 ? top : 0 };
      paper.save(); paper.beginPath(); paper.rect(box.x, box.y, box.width, box.height); paper.clip();
      this.view(paper, view, box, time);
      paper.restore();
      if (i) draw(paper, [[0, box.y], [width, box.y]], { stroke: colours.muted, width: 1 });
    });
  }
  view(paper, view, box, time) {
    const margin = 34, room = [box.width - box.right - 2 * margin, box.height - box.top - 2 * 30];
    const whole = Math.min(...[0, 1].map((c) => Math.max(room[c], 20) / Math.max(view.high[c] - view.low[c], 4 * scene.size, 1)));
    const scale = state.follow ? Math.max(whole, Math.min(box.width, box.height) / (7 * scene.size)) : whole;
    const middle = state.follow ? view.flat(between(flights[state.first].true, time)) : [0, 1].map((c) => (view.low[c] + view.high[c]) / 2);
    const flatAt = ([a, b]) => [(box.width - box.right) / 2 + (a - middle[0]) * scale, box.y + (box.height + box.top) / 2 - (b - middle[1]) * scale];
    const at = (place) => flatAt(view.flat(place));
    view.at = at;
    this.grid(paper, view, box, scale, flatAt, middle);
    if (view.above) {
      for (const [n, e, r] of rows(scene.obstacles)) draw(paper, circle(at([n, e, 0]), r * scale), { fill: colours.obstacle, alpha: 0.25, stroke: colours.obstacle, width: 1 });
      draw(paper, rows(scene.fairway).map(at), { fill: colours.true, alpha: 0.12, stroke: colours.muted, width: 1 });
    }
    draw(paper, rows(scene.path).map(at), { stroke: colours.commanded, dash: [6, 5] });
    if (scene.goal) draw(paper, circle(at(scene.goal), Math.max(scene.goal[3] * scale, 5)), { stroke: colours.goal, width: 2 });
    const length = Math.max(scene.size * scale, scene.least), factor = length / (scene.size * scale);
    for (const part of shown().reverse()) this.flight(paper, view, part, time, at, length, scale);
    const [x, y, align] = box.top ? [box.width - box.right - 10, 28, "right"] : [10, 16, "left"]; // beside the buttons, or above the tracks
    if (scene.hull !== "dot" && factor > 1.05) write(paper, `vehicle drawn ${number(factor, 2)} times its size`, x, box.y + y, align);
  }
  flight(paper, view, { flight, look }, time, at, length, scale) {
    const truth = between(flight.true, time), estimate = between(flight.believed, time), i = stepAt(flight, time);
    if (data.located) for (const place of fixes(flight, i)) cross(paper, at(place), 2.6, 1.1, 0.75, colours[look.fix]);
    const track = (array, now) => [...rows(array, i + 1), now].map(at);
    draw(paper, track(flight.true, truth), { stroke: colours.true, width: look.line, dash: look.dash });
    if (data.located) draw(paper, track(flight.believed, estimate), { stroke: colours[look.colour], width: 1.6, dash: look.dash });
    const [x, y] = at(estimate), flat = (off) => view.flat(shifted([0, 0, 0], off)).map((v, c) => (c ? -v : v) * scale);
    if (data.located) {
      if (flight.root) draw(paper, ellipse(flight, time, flat).map(([a, b]) => [x + a, y + b]), { fill: colours[look.band], stroke: colours[look.colour], width: 1.2 });
      for (const off of cloud(flight, time)) { const [a, b] = flat(off); draw(paper, circle([x + a, y + b], 1.7), { fill: colours[look.member] }); }
    } else if (view.above) this.headings(paper, flight, look, time, estimate, [x, y], 1.6 * length);
    draw(paper, this.hull(view, truth, at, length), { fill: colours.true, alpha: 0.35, stroke: colours.true, width: 1.6 });
    draw(paper, this.hull(view, estimate, at, length), { fill: "transparent", stroke: colours[look.colour], width: 1.8 });
  }
  hull(view, pose, at, length) {
    const [x, y] = at(pose), turn = view.above ? pose[5] : Math.PI / 2 - pose[4], c = Math.cos(turn), s = Math.sin(turn);
    return scene.outline.map(([a, b]) => [x + length * (a * s + b * c), y - length * (a * c - b * s)]);
  }
  /** Twice the standard deviation of a heading, and the members' headings, as rays, magnified. */
  headings(paper, flight, look, time, estimate, [x, y], far) {
    if (focus[0].name !== "heading") return;
    const ray = (off) => { const angle = estimate[5] + (off * 10 * Math.PI) / 180; return [x + far * Math.sin(angle), y - far * Math.cos(angle)]; };
    const sd = flight.root ? between(flight.root, time)[0] : 0;
    if (sd > 0) draw(paper, [[x, y], ...Array.from({ length: 17 }, (_, j) => ray(2 * sd * (j / 8 - 1)))], { fill: colours[look.band] });
    for (const [off] of cloud(flight, time)) draw(paper, [[x, y], ray(off)], { stroke: colours[look.member], width: 0.8 });
  }
  /** Lines at round values, which stand at the left and at the bottom; the water's surface in a view from the side. */
  grid(paper, view, box, scale, flatAt, middle) {
    const gap = round125(80 / scale), style = { stroke: colours.grid, width: 1 }, half = [box.width / scale, box.height / scale];
    const bottom = box.y + box.height, sign = view.above || scene.hull === "aircraft" ? 1 : -1, shift = view.above ? 0 : HEIGHT.of(0);
    for (const v of levels(middle[0] - half[0], middle[0] + half[0], gap)) {
      const [x] = flatAt([v, 0]);
      draw(paper, [[x, box.y], [x, bottom]], style);
      if (x > 74 && x < box.width - (view.above ? 70 : 130)) write(paper, number(v), x, bottom - 6, "center");
    }
    const rise = round125(45 / scale);
    for (const v of levels(middle[1] - half[1] - shift, middle[1] + half[1] - shift, rise)) {
      const [, y] = flatAt([0, v + shift]);
      draw(paper, [[0, y], [box.width, y]], style);
      if (y > box.y + box.top + 24 && y < bottom - 20 && (view.above || scene.surface === null || sign * v >= 0)) write(paper, number(sign * v), 6, y + 4);
    }
    write(paper, `${view.names[0]} [m]`, box.width - 8, bottom - 6, "right", colours.ink);
    write(paper, `${view.names[1]} [m]`, 6, bottom - 6, "left", colours.ink);
    if (view.above || scene.surface === null) return;
    const [, y] = flatAt([0, -scene.surface]);
    draw(paper, [[0, y], [box.width, y]], { stroke: colours.true, width: 2 });
    write(paper, "water surface", box.width - box.right - 10, y - 6, "right", colours.ink);
  }
  /** Pixels of a place in each view. */
  screen(place) { return this.views.map((view) => view.at(place)); }
  /** Direction on the screen [rad clockwise from up] of a level vector; none without a view from above. */
  bearing([north, east]) { return this.views[0].above ? Math.atan2(east, north) : (north < 0 ? -1 : 1) * Math.PI / 2; }
  theme() {}
}

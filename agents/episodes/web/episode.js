"use strict";
// An episode on several estimators: one clock, one stage (a map, or space), one close-up of the belief, and charts.
(() => {
  const element = (id) => document.getElementById(id);
  const style = getComputedStyle(document.documentElement);  // of now, whatever the reader's system asks for
  const colours = new Proxy({}, { get: (_, name) => style.getPropertyValue(`--${name}`).trim() });

  // --- data -----------------------------------------------------------------------------------------------------

  /** Arrays, which JSON holds in base64. */
  function unpack(_, packed) {
    if (!packed?.shape) return packed;
    const bytes = Uint8Array.from(atob(packed.float32), (c) => c.charCodeAt(0)), [rows, ...shape] = packed.shape;
    return { values: new Float32Array(bytes.buffer), rows, width: shape.reduce((a, b) => a * b, 1) };
  }
  const page = JSON.parse(element("episode").textContent, unpack), { scene, flights, focus, dt } = page;
  const row = (array, i) => array.values.subarray(i * array.width, (i + 1) * array.width);
  const rows = (array, end = array.rows) => Array.from({ length: end }, (_, i) => row(array, i));
  const duration = Math.max(...flights.map((f) => f.true.rows - 1)) * dt;
  const k = focus.length;

  /** A row between two steps, so that motion is smooth at any speed. */
  function between(array, time) {
    const at = Math.min(time / dt, array.rows - 1), i = Math.floor(at), share = at - i;
    const a = row(array, i), b = row(array, Math.min(i + 1, array.rows - 1));
    return Array.from(a, (value, j) => value + share * (b[j] - value));
  }
  const stepAt = (flight, time) => Math.min(Math.floor(time / dt + 1e-6), flight.true.rows - 1);
  /** A place, north, east and down, away from a pose by components of the position. */
  const shifted = (pose, off) => [0, 1, 2].map((c) => off.reduce((sum, v, j) => sum + v * focus[j].axis[c], pose[c]));
  /** Deviations of the ensemble's members from their mean, [m][k]; none without an ensemble. */
  function cloud({ members, period }, time) {
    if (!members) return [];
    const values = row(members, Math.min(Math.floor(time / period), members.rows - 1));
    return Array.from({ length: values.length / k }, (_, i) => Array.from(values.subarray(i * k, (i + 1) * k)));
  }
  /** Fixes of the position up to a step, as places. */
  const fixes = (flight, i) => rows(flight.fix, i + 1).flatMap((fix, j) => (Number.isFinite(fix[0]) ? [shifted(row(flight.true, j), [...fix])] : []));
  /** The last measurement of the close-up's components, minus the truth, and its age in seconds. */
  function lastFix(flight, time) {
    for (let i = stepAt(flight, time), first = Math.max(0, i - 4 / dt); i >= first; i--) {
      if (Number.isFinite(row(flight.fix, i)[0])) return { off: row(flight.fix, i), age: time - i * dt };
    }
    return null;
  }
  const round125 = (value) => {
    const power = 10 ** Math.floor(Math.log10(Math.max(value, 1e-9)));
    return power * [1, 2, 5, 10].find((f) => f * power >= value * 0.999999);
  };
  const number = (value, digits = 3) => (Number.isFinite(value) ? Number(value.toPrecision(digits)).toString().replace("-", "−") : "–");

  // --- state ----------------------------------------------------------------------------------------------------

  const state = { time: 0, flight: 0, playing: false, follow: false, speed: 1, dirty: true };
  const current = () => flights[state.flight];

  // --- canvas ---------------------------------------------------------------------------------------------------

  function sized(canvas) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const paper = canvas.getContext("2d");
    paper.setTransform(ratio, 0, 0, ratio, 0, 0);
    paper.clearRect(0, 0, width, height);
    paper.lineJoin = "round";
    return { paper, width, height };
  }
  /** Draw a line, or an area where it has a fill, with a closed outline. */
  function draw(paper, points, { stroke, width = 1.5, dash = [], fill, alpha = 1 }) {
    paper.beginPath();
    points.forEach(([x, y], i) => (i ? paper.lineTo(x, y) : paper.moveTo(x, y)));
    if (fill) { paper.closePath(); paper.globalAlpha = alpha; paper.fillStyle = fill; paper.fill(); paper.globalAlpha = 1; }
    if (stroke) { paper.setLineDash(dash); paper.strokeStyle = stroke; paper.lineWidth = width; paper.stroke(); }
  }
  function cross(paper, [x, y], r, width, alpha) {
    paper.globalAlpha = alpha;
    for (const s of [1, -1]) draw(paper, [[x - r, y - s * r], [x + r, y + s * r]], { stroke: colours.measurement, width });
    paper.globalAlpha = 1;
  }
  const TURN = Array.from({ length: 49 }, (_, i) => [Math.cos((i * Math.PI) / 24), Math.sin((i * Math.PI) / 24)]);
  const circle = ([x, y], r) => TURN.map(([a, b]) => [x + r * a, y + r * b]);
  /** Twice the standard deviation, and the members, about what is believed; `at` puts deviations from it. */
  function spread(paper, flight, time, at, radius) {
    if (flight.root) {
      const L = between(flight.root, time);
      draw(paper, TURN.map(([a, b]) => at(focus.map((_, j) => 2 * (L[j * k] * a + (L[j * k + 1] ?? 0) * b)))), { fill: colours.band, stroke: colours.believed, width: 1.2 });
    }
    for (const off of cloud(flight, time)) draw(paper, circle(at(off), radius), { fill: colours.member });
  }

  // --- the map --------------------------------------------------------------------------------------------------

  const extent = { low: scene.low, high: scene.high, middle: scene.low.map((v, j) => (v + scene.high[j]) / 2), span: Math.max(...scene.low.map((v, j) => scene.high[j] - v), 4 * scene.size, 1) };
  /** What the close-up takes of a view: a strip at the right of a wide one, at the top of a narrow one. */
  const aside = (width) => (width > 560 ? [element("close").offsetWidth, 0] : [0, element("close").offsetHeight]);

  class Plan {
    constructor(canvas) { this.canvas = canvas; }
    draw(flight, time) {
      const { paper, width, height } = sized(this.canvas);
      const truth = between(flight.true, time), believed = between(flight.believed, time), i = stepAt(flight, time);
      const [right, top] = aside(width), room = [width - right - 60, height - top - 70];
      const whole = Math.min(room[1] / Math.max(extent.high[0] - extent.low[0], 1), room[0] / Math.max(extent.high[1] - extent.low[1], 1));
      const scale = state.follow ? Math.max(whole, Math.min(width, height) / (7 * scene.size)) : whole;
      const middle = state.follow ? truth : extent.middle;
      const at = ([n, e]) => [(width - right) / 2 + (e - middle[1]) * scale, (height + top) / 2 - (n - middle[0]) * scale];
      this.grid(paper, width, height, scale, at([0, 0]));
      for (const [n, e, r] of rows(scene.obstacles)) draw(paper, circle(at([n, e]), r * scale), { fill: colours.obstacle, alpha: 0.25, stroke: colours.obstacle, width: 1 });
      draw(paper, rows(scene.fairway).map(at), { fill: colours.true, alpha: 0.12, stroke: colours.muted, width: 1 });
      draw(paper, rows(scene.path).map(at), { stroke: colours.commanded, dash: [6, 5] });
      if (scene.goal) draw(paper, circle(at(scene.goal), Math.max(scene.goal[3] * scale, 5)), { stroke: colours.goal, width: 2 });
      if (page.located) for (const place of fixes(flight, i)) cross(paper, at(place), 2.6, 1.1, 0.75);
      const track = (array, now) => [...rows(array, i + 1), now].map(at);
      draw(paper, track(flight.true, truth), { stroke: colours.true, width: 3 });
      if (page.located) draw(paper, track(flight.believed, believed), { stroke: colours.believed, width: 1.6 });
      const length = Math.max(scene.size * scale, scene.least), factor = length / (scene.size * scale);
      if (page.located) spread(paper, flight, time, (off) => at(shifted(believed, off)), 1.7);
      else this.headings(paper, flight, time, believed, at(believed), 1.6 * length);
      draw(paper, this.hull(truth, at, length), { fill: colours.true, alpha: 0.35, stroke: colours.true, width: 1.6 });
      draw(paper, this.hull(believed, at, length), { fill: "transparent", stroke: colours.believed, width: 1.8 });
      this.furniture(paper, width, height, scale, scene.hull !== "dot" && factor > 1.05 ? `vehicle drawn ${number(factor, 2)}×` : "");
    }
    hull(pose, at, length) {
      const [x, y] = at(pose), c = Math.cos(pose[5]), s = Math.sin(pose[5]);
      return scene.outline.map(([a, b]) => [x + length * (a * s + b * c), y - length * (a * c - b * s)]);
    }
    /** Twice the standard deviation of a heading, and the members' headings, as rays, magnified. */
    headings(paper, flight, time, believed, [x, y], far) {
      if (focus[0].name !== "heading") return;
      const ray = (off) => { const angle = believed[5] + (off * 10 * Math.PI) / 180; return [x + far * Math.sin(angle), y - far * Math.cos(angle)]; };
      const sd = flight.root ? between(flight.root, time)[0] : 0;
      if (sd > 0) draw(paper, [[x, y], ...Array.from({ length: 17 }, (_, j) => ray(2 * sd * (j / 8 - 1)))], { fill: colours.band });
      for (const [off] of cloud(flight, time)) draw(paper, [[x, y], ray(off)], { stroke: colours.member, width: 0.8 });
    }
    grid(paper, width, height, scale, [x0, y0]) {
      const gap = round125(70 / scale) * scale, style = { stroke: colours.grid, width: 1 };
      for (let x = ((x0 % gap) + gap) % gap; x < width; x += gap) draw(paper, [[x, 0], [x, height]], style);
      for (let y = ((y0 % gap) + gap) % gap; y < height; y += gap) draw(paper, [[0, y], [width, y]], style);
    }
    furniture(paper, width, height, scale, words) {
      const bar = round125(60 / scale), x = 14, y = height - 14, north = [width - 20, height - 16];
      draw(paper, [[x, y - 4], [x, y], [x + bar * scale, y], [x + bar * scale, y - 4]], { stroke: colours.ink });
      draw(paper, [[0, -26], [5, -12], [0, -15], [-5, -12]].map(([a, b]) => [north[0] + a, north[1] + b]), { fill: colours.ink });
      paper.font = "12px system-ui, sans-serif"; paper.textAlign = "left";
      paper.fillText(`${number(bar)} m${words ? `   ·   ${words}` : ""}`, x, y - 9);
      paper.textAlign = "center"; paper.fillText("N", ...north);
    }
    theme() {}
  }

  // --- space ----------------------------------------------------------------------------------------------------

  class Space {
    constructor(canvas) {
      this.canvas = canvas;
      this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
      this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
      this.camera = new THREE.PerspectiveCamera(40, 1, extent.span * 0.002, extent.span * 30);
      this.controls = new THREE.OrbitControls(this.camera, canvas);
      this.controls.enableDamping = false;
      this.controls.addEventListener("change", () => { state.dirty = true; });
      this.controls.addEventListener("start", () => { this.moved = true; });
      this.far = this.place(extent.middle);
      this.controls.target.copy(this.far);
      this.camera.position.copy(this.far).add(new THREE.Vector3(0.62, 0.62, 0.85));
      this.build();
    }
    /** As near as all of path and flights is seen, beside the close-up and from where the camera looks. */
    fit() {
      const away = this.camera.position.clone().sub(this.controls.target).normalize(), [right, top] = aside(this.width);
      const some = (array) => rows(array).filter((_, i) => i % Math.ceil(array.rows / 40) === 0 || i === array.rows - 1);
      const shown = [scene.path, ...flights.map((f) => f.true)].flatMap((array) => some(array).map(this.place));
      const seen = (point) => {
        const p = point.clone().project(this.camera), x = (p.x + 1) * 0.5 * this.width, y = (1 - p.y) * 0.5 * this.height;
        return x > 24 && x < this.width - right - 24 && y > top + 30 && y < this.height - 24;
      };
      this.controls.target.copy(this.far);
      for (let distance = 0.6 * extent.span; distance < 12 * extent.span; distance *= 1.05) {
        this.camera.position.copy(this.far).addScaledVector(away, distance);
        this.camera.lookAt(this.far); this.camera.updateMatrixWorld();
        if (shown.every(seen)) break;
      }
    }
    place(p) { return new THREE.Vector3(p[1], -p[2], -p[0]); }
    build() {
      this.scene = new THREE.Scene();
      this.scene.background = new THREE.Color(colours.water);
      this.scene.add(new THREE.HemisphereLight("#ffffff", "#8899aa", 2.2));
      const sun = new THREE.DirectionalLight("#ffffff", 1.6);
      sun.position.set(0.4, 1, 0.3); this.scene.add(sun);
      const step = round125(extent.span / 8), count = 2 * Math.ceil((0.75 * extent.span) / step) + 2;
      this.step = step;
      const floor = scene.hull === "aircraft" ? Math.max(0, extent.high[2]) : extent.high[2] + 0.06 * extent.span;
      const grid = new THREE.GridHelper(step * count, count, colours.edge, colours.edge);
      const snap = (v) => Math.round(v / step) * step;
      grid.position.set(snap(this.far.x), -floor, snap(this.far.z)); this.scene.add(grid);
      this.floor = floor;
      if (scene.surface !== null) {
        const sea = new THREE.Mesh(new THREE.PlaneGeometry(step * count, step * count),
          new THREE.MeshBasicMaterial({ color: colours.true, transparent: true, opacity: 0.1, side: THREE.DoubleSide, depthWrite: false }));
        sea.rotation.x = -Math.PI / 2; sea.position.set(snap(this.far.x), -scene.surface, snap(this.far.z)); this.scene.add(sea);
      }
      for (const [n, e, r] of rows(scene.obstacles)) {
        const up = floor - extent.low[2] + 0.12 * extent.span;
        const tower = new THREE.Mesh(new THREE.CylinderGeometry(r, r, up, 40),
          new THREE.MeshLambertMaterial({ color: colours.obstacle, transparent: true, opacity: 0.42, depthWrite: false }));
        tower.position.set(e, -floor + up / 2, -n); this.scene.add(tower);
      }
      const line = (array, stroke, thickness, dashed) => {
        const made = new THREE.Line2(new THREE.LineGeometry().setPositions(rows(array).flatMap((p) => this.place(p).toArray())),
          new THREE.LineMaterial({ color: stroke, linewidth: thickness, dashed: Boolean(dashed), dashSize: extent.span / 90, gapSize: extent.span / 110 }));
        if (dashed) made.computeLineDistances();
        made.frustumCulled = false; this.scene.add(made);
        return made;
      };
      if (scene.path.rows > 1) line(scene.path, colours.commanded, 2, true);
      if (scene.goal) {
        const goal = new THREE.Mesh(new THREE.SphereGeometry(Math.max(scene.goal[3], extent.span / 120), 24, 16),
          new THREE.MeshLambertMaterial({ color: colours.goal, transparent: true, opacity: 0.45, depthWrite: false }));
        goal.position.copy(this.place(scene.goal)); this.scene.add(goal);
      }
      this.tracks = flights.map((f) => ({ true: line(f.true, colours.true, 3.5), believed: line(f.believed, colours.believed, 2) }));
      const length = (this.length = Math.max(scene.size, 0.05 * extent.span));
      this.true = this.vehicle(length, colours.true, false);
      this.believed = this.vehicle(length * 1.04, colours.believed, true);
      this.drop = new THREE.Line2(new THREE.LineGeometry().setPositions([0, 0, 0, 0, -1, 0]), new THREE.LineMaterial({ color: colours.muted, linewidth: 1.2 }));
      this.drop.frustumCulled = false; this.scene.add(this.drop);
      this.ellipsoid = new THREE.Mesh(new THREE.SphereGeometry(1, 32, 20),
        new THREE.MeshBasicMaterial({ color: colours.believed, transparent: true, opacity: 0.25, depthWrite: false }));
      this.ellipsoid.matrixAutoUpdate = false; this.ellipsoid.frustumCulled = false; this.scene.add(this.ellipsoid);
      this.members = this.points(200, colours.member, 4);
      this.fixes = this.points(Math.max(...flights.map((f) => f.true.rows)), colours.measurement, 4);
    }
    points(count, fill, size) {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * count), 3));
      const made = new THREE.Points(geometry, new THREE.PointsMaterial({ color: fill, size: size * Math.min(window.devicePixelRatio || 1, 2), sizeAttenuation: false }));
      made.frustumCulled = false; this.scene.add(made);
      return made;
    }
    /** A body whose nose points along -z (north), and its mast along y (up). */
    vehicle(length, fill, wire) {
      const group = new THREE.Group(), material = wire
        ? new THREE.MeshBasicMaterial({ color: fill, wireframe: true, transparent: true, opacity: 0.75 })
        : new THREE.MeshLambertMaterial({ color: fill });
      const add = (geometry, x = 0, y = 0, z = 0) => {
        const mesh = new THREE.Mesh(geometry, material);
        mesh.position.set(x * length, y * length, z * length); group.add(mesh);
        return mesh;
      };
      const rounds = wire ? 8 : 24;
      if (scene.hull === "aircraft") {
        const wing = new THREE.Shape();
        scene.outline.forEach(([a, b], i) => (i ? wing.lineTo(b * length, a * length) : wing.moveTo(b * length, a * length)));
        material.side = THREE.DoubleSide;
        add(new THREE.ShapeGeometry(wing)).rotation.x = -Math.PI / 2;
        add(new THREE.CapsuleGeometry(0.05 * length, 0.3 * length, 4, rounds), 0, 0, -0.06).rotation.x = Math.PI / 2;
      } else if (scene.hull === "dot") add(new THREE.SphereGeometry(0.3 * length, rounds, rounds / 2));
      else {
        add(new THREE.CapsuleGeometry(0.08 * length, 0.8 * length, wire ? 2 : 8, rounds)).rotation.x = Math.PI / 2;
        add(new THREE.BoxGeometry(0.4 * length, 0.015 * length, 0.09 * length), 0, 0, 0.42);
        add(new THREE.BoxGeometry(0.015 * length, 0.4 * length, 0.09 * length), 0, 0, 0.42);
      }
      group.rotation.order = "YXZ"; this.scene.add(group);
      return group;
    }
    put(group, pose) {
      group.position.copy(this.place(pose));
      group.rotation.set(pose[4], -pose[5], -pose[3]);
    }
    theme() { this.build(); }
    draw(flight, time) {
      const width = this.canvas.clientWidth, height = this.canvas.clientHeight, i = stepAt(flight, time);
      if (this.width !== width || this.height !== height) {
        this.renderer.setSize(width, height, false);
        this.camera.aspect = width / Math.max(height, 1); this.camera.updateProjectionMatrix();
        const [right, top] = aside(width);
        this.camera.setViewOffset(width, height, right / 2, -top / 2, width, height);
        this.width = width; this.height = height;
        if (!this.moved && !this.followed) this.fit();
      }
      const truth = between(flight.true, time), believed = between(flight.believed, time);
      this.tracks.forEach((each, j) => {
        each.true.visible = each.believed.visible = flights[j] === flight && i > 0;
        each.true.geometry.instanceCount = each.believed.geometry.instanceCount = i;
      });
      this.put(this.true, truth); this.put(this.believed, believed);
      const size = state.follow ? Math.max(scene.size / this.length, 0.05) : 1;
      this.true.scale.setScalar(size); this.believed.scale.setScalar(size);
      this.drop.position.copy(this.true.position); this.drop.scale.set(1, Math.max(this.floor - truth[2], 1e-6), 1);
      this.ellipsoid.visible = Boolean(flight.root) && page.located;
      if (this.ellipsoid.visible) {
        const L = between(flight.root, time), thin = [[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]];
        const columns = thin.map((least, c) => new THREE.Vector3(...(c < k ? this.place(shifted([0, 0, 0], focus.map((_, r) => 2 * L[r * k + c]))).toArray() : least)));
        columns.forEach((column, c) => { if (!column.lengthSq()) column.set(...thin[c]); });
        this.ellipsoid.matrix.makeBasis(...columns).setPosition(this.believed.position);
      }
      this.fill(this.members, cloud(flight, time).map((off) => shifted(believed, off)));
      this.fill(this.fixes, page.located ? fixes(flight, i) : []);
      this.look(truth);
      this.renderer.render(this.scene, this.camera);
    }
    /** Follow the vehicle, or hand the whole back. */
    look() {
      const now = this.true.position;
      if (state.follow) {
        if (!this.followed) {
          const back = this.camera.position.clone().sub(this.controls.target).setLength(Math.max(14 * scene.size, 0.04 * extent.span));
          this.camera.position.copy(now).add(back); this.controls.target.copy(now);
        } else {
          this.camera.position.add(now).sub(this.followed); this.controls.target.copy(now);
        }
        this.followed = now.clone();
      } else if (this.followed) {
        this.fit();
        this.followed = null;
      }
      this.camera.lookAt(this.controls.target);
    }
    fill(points, places) {
      const array = points.geometry.attributes.position, count = Math.min(places.length, array.count);
      places.slice(0, count).forEach((place, i) => array.setXYZ(i, ...this.place(place).toArray()));
      array.needsUpdate = true; points.geometry.setDrawRange(0, count);
    }
  }

  // --- the close-up: what is believed, about the truth ----------------------------------------------------------

  function closeUp(flight, time) {
    const { paper, width, height } = sized(element("belief")), L = flight.root ? between(flight.root, time) : new Array(k * k).fill(0);
    paper.font = "11px system-ui, sans-serif";
    (k === 1 ? bell : target)(paper, width, height, flight, time, between(flight.error, time), L, lastFix(flight, time));
  }
  function target(paper, width, height, flight, time, error, L, fix) {
    const reach = round125(Math.max(1.05 * Math.max(Math.abs(error[0]) + 2 * L[0], Math.abs(error[1]) + 2 * Math.hypot(L[k], L[k + 1])), 1e-3));
    const cx = width / 2, cy = height / 2, scale = (Math.min(width, height) / 2 - 12) / reach, edge = { stroke: colours.edge, width: 1 };
    const at = ([a, b]) => [cx + a * scale, cy + DOWN * b * scale];
    for (const r of [0.5, 1]) draw(paper, circle([cx, cy], r * reach * scale), edge);
    draw(paper, [at([-reach, 0]), at([reach, 0])], edge);
    draw(paper, [at([0, -reach]), at([0, reach])], edge);
    paper.fillStyle = colours.muted; paper.textAlign = "left";
    paper.fillText(`${number(reach)} ${focus[0].unit}`, cx + 4, cy - reach * scale + 1);
    spread(paper, flight, time, (off) => at([error[0] + off[0], error[1] + off[1]]), 1.8);
    if (fix) {
      const far = Math.hypot(fix.off[0], fix.off[1]) / reach, alpha = Math.max(0.2, 1 - fix.age / 4);
      if (far <= 1) cross(paper, at(fix.off), 4.5, 2, alpha);
      else {  // beyond the rim: an arrow that points to it
        const tip = at([fix.off[0] / far, fix.off[1] / far]), angle = Math.atan2(tip[1] - cy, tip[0] - cx);
        const fin = (turn) => [tip[0] - 8 * Math.cos(angle + turn), tip[1] - 8 * Math.sin(angle + turn)];
        paper.globalAlpha = alpha; draw(paper, [fin(0.5), tip, fin(-0.5)], { stroke: colours.measurement, width: 2 }); paper.globalAlpha = 1;
      }
    }
    draw(paper, circle(at(error), 3.5), { fill: colours.believed });
    draw(paper, circle([cx, cy], 4.5), { fill: colours.true });
  }
  function bell(paper, width, height, flight, time, [error], [sd], fix) {
    const base = height - 24, reach = round125(Math.max(Math.abs(error) + 3 * sd, fix ? Math.abs(fix.off[0]) : 0, 1e-3));
    const x = (v) => width / 2 + (v / reach) * (width / 2 - 12), post = (v, high) => [[x(v), base], [x(v), high]];
    draw(paper, [[8, base], [width - 8, base]], { stroke: colours.edge, width: 1 });
    paper.fillStyle = colours.muted; paper.textAlign = "center";
    for (const v of [-reach, 0, reach]) paper.fillText(`${v > 0 ? "+" : ""}${number(v)}${focus[0].unit}`, Math.max(18, Math.min(width - 18, x(v))), height - 8);
    if (sd > 0) {
      const curve = Array.from({ length: 81 }, (_, i) => (i - 40) / 10).map((z) => [x(error + z * sd), base - (base - 26) * Math.exp(-0.5 * z * z)]);
      draw(paper, curve, { fill: colours.band, stroke: colours.believed });
    }
    for (const [off] of cloud(flight, time)) draw(paper, post(error + off, base - 14), { stroke: colours.member, width: 1 });
    draw(paper, post(error, 18), { stroke: colours.believed, width: 2 });
    draw(paper, post(0, 10), { stroke: colours.true, width: 2 });
    if (fix) cross(paper, [x(fix.off[0]), base - 30], 4.5, 2, Math.max(0.2, 1 - fix.age / 4));
  }

  // --- charts ---------------------------------------------------------------------------------------------------

  let charts = [];
  function layCharts() {
    charts.forEach((chart) => chart.plot.destroy());
    charts = current().charts.map((chart) => {
      const box = document.createElement("div");
      box.innerHTML = '<h2><span></span><small></small><output></output></h2><div class="plot" role="img"></div>';
      const [name, labels, value] = box.firstChild.children, room = box.lastChild;
      name.textContent = chart.title; labels.append(...chart.series.filter(({ label }) => label).map(({ label, colour }) => {
        const item = document.createElement("span");
        item.textContent = label; item.style.setProperty("--line", `var(--${colour})`);
        return item;
      }));
      room.setAttribute("aria-label", `${chart.title} over time on ${current().estimator}`);
      return { chart, box, room, value };
    });
    element("charts").replaceChildren(...charts.map(({ box }) => box));
    charts.forEach(plot);
  }
  function plot(each) {
    const { chart, room } = each, { length } = chart.series[0].value.values, blank = new Array(length).fill(null);
    const plain = (array) => (array ? Array.from(array.values, (v) => (Number.isFinite(v) ? v : null)) : blank);
    const axis = { stroke: () => colours.muted, grid: { stroke: () => colours.grid, width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    const edge = { stroke: "transparent", points: { show: false } }, stroke = () => colours.measurement;
    const levels = [...new Set([chart.ticks[0], ...chart.ticks.filter((level) => level === 0), chart.ticks.at(-1)])];
    const options = {
      width: Math.max(room.clientWidth, 50), height: Math.max(room.clientHeight, 50), legend: { show: false }, padding: [6, 22, 0, 0],
      cursor: { drag: { x: false, y: false }, y: false, points: { show: false } },
      scales: { x: { time: false, range: [0, duration] }, y: { range: chart.limits } },
      axes: [{ ...axis, size: 20, gap: 2, values: (_, at) => at.map((v) => `${v} s`) }, { ...axis, size: 44, gap: 3, splits: () => levels, values: (_, at) => at.map((v) => number(v)) }],
      bands: [{ series: [1, 2], fill: () => colours.band }],
      series: [{}, edge, edge, { stroke: () => colours.zero, width: 1, points: { show: false } },
        { width: 0, paths: () => null, points: { show: true, size: 3, fill: stroke, stroke } },
        ...chart.series.map(({ colour, width }) => ({ stroke: () => colours[colour], width, points: { show: false } }))],
    };
    const zero = chart.limits[0] < 0 && chart.limits[1] > 0 ? new Array(length).fill(0) : blank, [low, high] = chart.band ?? [];
    each.plot = new uPlot(options, [blank.map((_, i) => i * dt), plain(high), plain(low), zero, plain(chart.measured), ...chart.series.map(({ value }) => plain(value))], room);
    each.veil = document.createElement("div"); each.veil.className = "veil";
    each.plot.over.append(each.veil);
    const seek = (event) => {
      const box = each.plot.over.getBoundingClientRect();
      go(((event.clientX - box.left) / box.width) * duration);
    };
    each.plot.over.addEventListener("pointerdown", (event) => { each.plot.over.setPointerCapture(event.pointerId); seek(event); });
    each.plot.over.addEventListener("pointermove", (event) => { if (event.buttons) seek(event); });
  }
  function drawCharts(flight, time) {
    const i = stepAt(flight, time);
    for (const { chart, plot, veil, value } of charts) {
      veil.style.left = `${plot.valToPos(Math.min(time, duration), "x")}px`;
      const v = chart.series.at(-1).value.values[i], half = chart.band ? (chart.band[1].values[i] - chart.band[0].values[i]) / 2 : NaN;
      const known = Number.isFinite(v) ? number(v) + (Number.isFinite(half) ? ` ± ${number(half, 2)}` : "") : "";
      value.textContent = chart.series.at(-1).label === "true" ? "not estimated" : known;
    }
  }

  // --- controls -------------------------------------------------------------------------------------------------

  function go(time) { state.time = Math.max(0, Math.min(duration, time)); state.dirty = true; }
  function play(on) {
    if (on && state.time >= duration) state.time = 0;
    state.playing = on; state.dirty = true;
    element("play").textContent = on ? "❚❚" : "►"; element("play").setAttribute("aria-label", on ? "Pause" : "Play");
    if (!on) tell();
  }
  function follow(on) { state.follow = on; state.dirty = true; element("follow").setAttribute("aria-pressed", String(on)); }
  function choose(index) {
    if (index < 0 || index >= flights.length) return;
    state.flight = index; state.dirty = true;
    [...element("estimators").children].forEach((button, i) => { button.setAttribute("aria-checked", String(i === index)); button.tabIndex = i === index ? 0 : -1; });
    layCosts(); layLegend(); layCharts(); tell();
  }
  function layCosts() {
    element("costs").replaceChildren(...current().costs.map(({ label, value, unit, meaning }) => {
      const item = document.createElement("li"), amount = document.createElement("b");
      amount.textContent = `${value}${unit ? ` ${unit}` : ""}`;
      item.title = meaning; item.append(`${label} `, amount);
      return item;
    }));
  }
  function tell() {
    const flight = current(), i = stepAt(flight, state.time);
    const words = focus.map(({ name, unit }, j) => `${name} error ${number(row(flight.error, i)[j])} ${unit}`).join(", ");
    const told = `${flight.estimator} at ${state.time.toFixed(1)} s: ${words}. Final score ${number(flight.score)}${flight.end ? `, ${flight.end}` : ""}.`;
    element("status").textContent = told; element("view").setAttribute("aria-label", told); element("belief").setAttribute("aria-label", `Belief about the truth, close up. ${told}`);
  }
  const line = (stroke, extra) => `<line x1="0" y1="6" x2="22" y2="6" stroke="var(--${stroke})" ${extra}/>`;
  const round = (r, extra) => `<circle cx="11" cy="6" r="${r}" ${extra}/>`;
  const ICONS = {  // in the order of the legend
    true: line("true", 'stroke-width="3"'), believed: line("believed", 'stroke-width="2"'),
    ellipse: '<ellipse cx="11" cy="6" rx="10" ry="5" fill="var(--band)" stroke="var(--believed)"/>',
    cloud: [[4, 8], [11, 4], [17, 7]].map(([x, y]) => `<circle cx="${x}" cy="${y}" r="2" fill="var(--member)"/>`).join(""),
    fix: '<path d="M7 2 15 10 M7 10 15 2" stroke="var(--measurement)" stroke-width="2"/>',
    path: line("commanded", 'stroke-width="2" stroke-dasharray="5 4"'),
    fairway: '<rect x="1" y="2" width="20" height="8" fill="var(--true)" fill-opacity="0.12" stroke="var(--muted)"/>',
    goal: round(5, 'fill="none" stroke="var(--goal)" stroke-width="2"'), obstacle: round(6, 'fill="var(--obstacle)" opacity="0.5"'),
  };
  function layLegend() {
    const flight = current(), labels = { ...flight.legend };
    if (!page.located) {
      labels.believed = `${focus[0].name} believed by ${flight.estimator}; its place is not estimated`;
      if (flight.fix.values.some(Number.isFinite)) labels.fix = `measured ${focus[0].name}`;
      if (flight.root) labels.ellipse = `believed ${focus[0].name} ±2σ, 10×`;
    }
    element("legend").replaceChildren(...Object.keys(ICONS).filter((kind) => labels[kind]).map((kind) => {
      const item = document.createElement("li"), text = document.createElement("span");
      const icon = kind === "fix" && stage instanceof Space ? '<rect x="9" y="4" width="5" height="5" fill="var(--measurement)"/>' : ICONS[kind];
      item.innerHTML = `<svg viewBox="0 0 22 12" aria-hidden="true">${icon}</svg>`; // icons are ours; words of others go in as text
      text.textContent = labels[kind]; item.append(text);
      return item;
    }));
  }

  element("name").textContent = page.name;
  element("conditions").textContent = [...(page.environment === page.name ? [] : [page.environment]), ...page.conditions].join("  ·  ");
  flights.forEach((flight, i) => {
    const button = document.createElement("button"), score = document.createElement("small");
    button.type = "button"; button.setAttribute("role", "radio"); button.textContent = flight.estimator;
    button.title = `Key ${i + 1}`; score.textContent = flight.score.toFixed(3); score.title = "final score";
    button.append(score); button.addEventListener("click", () => choose(i)); element("estimators").append(button);
  });
  /** Which way the second of what is shown close up grows, in pixels: depth to the bottom, all else to the top. */
  const DOWN = focus[1]?.axis[2] > 0 ? 1 : -1;
  const close = k === 1 ? focus[0].name : `${focus[0].name} → and ${focus[1].name} ${DOWN > 0 ? "↓" : "↑"}`;
  element("close-title").textContent = `Close-up: ${close} off the truth`;
  element("orbit").hidden = !scene.space;
  for (const speed of [0.5, 1, 2, 5, 10, 20, 50, 100]) {
    const option = document.createElement("option");
    option.value = speed; option.textContent = `${speed}×`; element("speed").append(option);
  }
  const usual = [1, 2, 5, 10, 20, 50, 100].find((s) => duration / s <= 30) ?? 100;
  element("speed").value = String((state.speed = usual));
  element("time").max = duration;
  element("time").addEventListener("input", (event) => go(Number(event.target.value)));
  element("play").addEventListener("click", () => play(!state.playing));
  element("follow").addEventListener("click", () => follow(!state.follow));
  element("speed").addEventListener("change", (event) => { state.speed = Number(event.target.value); });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const jump = event.shiftKey ? 10 : 1;
    const keys = {
      " ": () => play(!state.playing), Home: () => go(0), End: () => go(duration), f: () => follow(!state.follow), F: () => follow(!state.follow),
      ArrowRight: () => go((Math.round(state.time / dt) + jump) * dt), ArrowLeft: () => go((Math.round(state.time / dt) - jump) * dt),
    };
    const action = keys[event.key] ?? (/^[1-9]$/.test(event.key) ? () => choose(Number(event.key) - 1) : null);
    if (action) { event.preventDefault(); action(); }
  });

  let stage;
  try {
    stage = scene.space && !page.flat ? new Space(element("view")) : new Plan(element("view"));
  } catch {  // no WebGL here: the same from above. A canvas that was asked for one kind of paper has no other.
    const fresh = element("view").cloneNode();
    element("view").replaceWith(fresh);
    stage = new Plan(fresh);
  }
  if (!page.placed) { element("view").hidden = true; element("buttons").hidden = true; }

  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { stage.theme(); layCharts(); state.dirty = true; });
  new ResizeObserver(() => {
    for (const { plot, room } of charts) plot.setSize({ width: Math.max(room.clientWidth, 50), height: Math.max(room.clientHeight, 50) });
    state.dirty = true;
  }).observe(document.body);

  let before = null;
  function frame(now) {
    if (state.playing && before !== null) {
      state.time += (state.speed * Math.min(now - before, 100)) / 1000; state.dirty = true;
      if (state.time >= duration) { state.time = duration; play(false); }
    }
    before = now;
    if (state.dirty) {
      state.dirty = false;
      const flight = current();
      stage.draw(flight, state.time);
      closeUp(flight, state.time);
      drawCharts(flight, state.time);
      element("time").value = state.time;
      element("time").setAttribute("aria-valuetext", `${state.time.toFixed(1)} seconds`);
      element("clock").textContent = `${state.time.toFixed(1)} / ${duration.toFixed(1)} s`;
      const last = (flight.true.rows - 1) * dt;
      element("ended").textContent = flight.end && state.time >= last ? `${flight.end} at ${last.toFixed(1)} s` : "";
    }
    requestAnimationFrame(frame);
  }

  // "#t=30&estimator=2" opens a page at a moment, at rest; without it the page plays, unless its reader wants no motion.
  const asked = new URLSearchParams(location.hash.slice(1));
  choose(Math.min(flights.length, Math.max(1, Math.floor(Number(asked.get("estimator"))) || 1)) - 1);
  if (asked.has("follow")) follow(true);
  if (asked.has("t")) go(Number(asked.get("t")) || 0);
  play(!asked.has("t") && !window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  requestAnimationFrame(frame);
})();

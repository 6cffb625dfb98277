"use strict";
// An episode on several estimators: one clock, one stage (a map, or space), one close-up of the belief, and charts.
(() => {
  const page = JSON.parse(document.getElementById("episode").textContent);
  const element = (id) => document.getElementById(id);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  let colours = {};
  function look() {
    for (const name of ["paper", "ink", "muted", "edge", "grid", "water", "true", "believed", "member", "measurement", "commanded", "goal", "obstacle", "band"]) colours[name] = colour(name);
  }
  look();

  // --- data -----------------------------------------------------------------------------------------------------

  function unpack(packed) {
    if (!packed) return null;
    const bytes = Uint8Array.from(atob(packed.float32 ?? packed.int16), (c) => c.charCodeAt(0));
    const values = packed.float32 !== undefined ? new Float32Array(bytes.buffer) : new Int16Array(bytes.buffer);
    const shape = packed.shape;
    return { ...packed, values, rows: shape[0], width: shape.slice(1).reduce((a, b) => a * b, 1), float32: null, int16: null };
  }
  const row = (array, i) => array.values.subarray(i * array.width, (i + 1) * array.width);

  const scene = { ...page.scene, path: unpack(page.scene.path), obstacles: unpack(page.scene.obstacles) };
  const flights = page.flights.map((flight) => ({
    ...flight,
    true: unpack(flight.true), believed: unpack(flight.believed), error: unpack(flight.error),
    covariance: unpack(flight.covariance), members: unpack(flight.members), fix: unpack(flight.fix),
    charts: flight.charts.map((chart) => ({
      ...chart, true: unpack(chart.true), believed: unpack(chart.believed), two_sigma: unpack(chart.two_sigma), measurements: unpack(chart.measurements),
    })),
  }));
  const dt = page.dt;
  const duration = Math.max(...flights.map((f) => f.true.rows - 1)) * dt;
  const k = page.focus.length;

  /** A row between two steps, so that motion is smooth at any speed. */
  function between(array, time) {
    const at = Math.min(time / dt, array.rows - 1), i = Math.floor(at), share = at - i;
    const a = row(array, i), b = row(array, Math.min(i + 1, array.rows - 1));
    return Array.from(a, (value, j) => value + share * (b[j] - value));
  }
  const stepAt = (flight, time) => Math.min(Math.floor(time / dt + 1e-6), flight.true.rows - 1);

  /** Lower triangular L with L L' = cov, of a k x k covariance given row by row. */
  function root(cov, k) {
    const L = new Float64Array(k * k);
    for (let i = 0; i < k; i++) for (let j = 0; j <= i; j++) {
      let sum = cov[i * k + j];
      for (let m = 0; m < j; m++) sum -= L[i * k + m] * L[j * k + m];
      L[i * k + j] = i === j ? Math.sqrt(Math.max(sum, 0)) : L[j * k + j] > 0 ? sum / L[j * k + j] : 0;
    }
    return L;
  }
  /** Where the members of the ensemble are from their mean, [m][k]; null where there is none. */
  function cloud(flight, time) {
    const members = flight.members;
    if (!members) return null;
    const frame = Math.min(Math.floor(time / (members.every * stepTime)), members.rows - 1);
    const values = row(members, frame), found = [];
    for (let i = 0; i < values.length; i += k) found.push(Array.from(values.subarray(i, i + k), (v) => v * members.unit));
    return found;
  }
  const stepTime = page.step;
  /** The last measurement that gave all that is shown close up, off the truth, and its age in seconds. */
  function lastFix(flight, time) {
    for (let i = stepAt(flight, time), first = Math.max(0, i - 4 / dt); i >= first; i--) {
      const fix = row(flight.fix, i);
      if (fix.slice(0, Math.min(k, 2)).every(Number.isFinite)) return { off: fix, age: time - i * dt };
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
    return { paper, width, height };
  }
  function trace(paper, points, closed) {
    paper.beginPath();
    points.forEach(([x, y], i) => (i ? paper.lineTo(x, y) : paper.moveTo(x, y)));
    if (closed) paper.closePath();
  }
  function cross(paper, x, y, r) {
    paper.beginPath();
    paper.moveTo(x - r, y - r); paper.lineTo(x + r, y + r); paper.moveTo(x - r, y + r); paper.lineTo(x + r, y - r);
    paper.stroke();
  }
  const dot = (paper, x, y, r) => { paper.beginPath(); paper.arc(x, y, r, 0, 2 * Math.PI); };
  const TURN = Array.from({ length: 49 }, (_, i) => [Math.cos((i * Math.PI) / 24), Math.sin((i * Math.PI) / 24)]);

  // Outlines in lengths, forward and starboard.
  const HULLS = {
    ship: [[0.5, 0], [0.36, 0.055], [0.2, 0.075], [-0.4, 0.075], [-0.5, 0.06], [-0.5, -0.06], [-0.4, -0.075], [0.2, -0.075], [0.36, -0.055]],
    torpedo: [[0.5, 0], [0.46, 0.05], [0.36, 0.075], [-0.25, 0.075], [-0.38, 0.05], [-0.4, 0.15], [-0.48, 0.15], [-0.5, 0.02],
      [-0.5, -0.02], [-0.48, -0.15], [-0.4, -0.15], [-0.38, -0.05], [-0.25, -0.075], [0.36, -0.075], [0.46, -0.05]],
    aircraft: [[0.3, 0], [0.22, 0.06], [-0.12, 0.5], [-0.2, 0.5], [-0.1, 0.08], [-0.2, 0], [-0.1, -0.08], [-0.2, -0.5], [-0.12, -0.5], [0.22, -0.06]],
    dot: TURN.filter((_, i) => i % 4 === 0).map(([a, b]) => [0.5 * a, 0.5 * b]),
  };
  HULLS.ship = HULLS.ship.map(([a, b]) => [a, b * 1.25]);

  // --- the map --------------------------------------------------------------------------------------------------

  function bounds() {
    let low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const take = (p) => p.forEach((v, j) => { if (j < 3 && Number.isFinite(v)) { low[j] = Math.min(low[j], v); high[j] = Math.max(high[j], v); } });
    for (const f of flights) for (let i = 0; i < f.true.rows; i++) take(row(f.true, i));
    for (let i = 0; i < scene.path.rows; i++) take(row(scene.path, i));
    for (let i = 0; i < scene.obstacles.rows; i++) {
      const [n, e, r] = row(scene.obstacles, i);
      take([n - r, e - r]); take([n + r, e + r]);
    }
    return { low, high, middle: low.map((v, j) => (v + high[j]) / 2), span: Math.max(...low.map((v, j) => high[j] - v), 4 * scene.size, 1) };
  }
  const extent = bounds();
  /** What the close-up takes of a view: a strip at the right of a wide one, at the top of a narrow one. */
  const aside = (width) => (width > 560 ? [element("close").offsetWidth, 0] : [0, element("close").offsetHeight]);

  class Plan {
    constructor(canvas) { this.canvas = canvas; this.zoom = 1; this.words = ""; }
    draw(flight, time) {
      const { paper, width, height } = sized(this.canvas);
      const truth = between(flight.true, time), believed = between(flight.believed, time), i = stepAt(flight, time);
      const [right, top] = aside(width), room = [width - right - 60, height - top - 70];
      const whole = Math.min(room[1] / Math.max(extent.high[0] - extent.low[0], 1), room[0] / Math.max(extent.high[1] - extent.low[1], 1));
      const scale = state.follow ? Math.max(whole, Math.min(width, height) / (7 * scene.size)) : whole;
      const middle = state.follow ? truth : extent.middle;
      const centre = [(width - right) / 2, (height + top) / 2];
      const at = (n, e) => [centre[0] + (e - middle[1]) * scale, centre[1] - (n - middle[0]) * scale];
      this.grid(paper, width, height, scale, at(0, 0));
      for (let j = 0; j < scene.obstacles.rows; j++) {
        const [n, e, r] = row(scene.obstacles, j), [x, y] = at(n, e);
        dot(paper, x, y, r * scale); paper.globalAlpha = 0.25; paper.fillStyle = colours.obstacle; paper.fill(); paper.globalAlpha = 1;
        paper.strokeStyle = colours.obstacle; paper.lineWidth = 1; paper.stroke();
      }
      paper.lineJoin = "round";
      paper.setLineDash([6, 5]); paper.strokeStyle = colours.commanded; paper.lineWidth = 1.5;
      trace(paper, Array.from({ length: scene.path.rows }, (_, j) => at(...row(scene.path, j)))); paper.stroke(); paper.setLineDash([]);
      if (scene.goal) {
        const [x, y] = at(scene.goal[0], scene.goal[1]);
        dot(paper, x, y, Math.max(scene.goal[3] * scale, 5)); paper.strokeStyle = colours.goal; paper.lineWidth = 2; paper.stroke();
      }
      if (page.located) {
        paper.strokeStyle = colours.measurement; paper.lineWidth = 1.1; paper.globalAlpha = 0.75;
        for (let j = 0; j <= i; j++) {
          const fix = row(flight.fix, j), t = row(flight.true, j);
          if (Number.isFinite(fix[0]) && Number.isFinite(fix[1])) cross(paper, ...at(t[0] + fix[1], t[1] + fix[0]), 2.6);
        }
        paper.globalAlpha = 1;
      }
      this.track(paper, flight.true, i, truth, at, colours.true, 3);
      if (page.located) this.track(paper, flight.believed, i, believed, at, colours.believed, 1.6);
      const length = Math.max(scene.size * scale, scene.hull === "dot" ? 11 : scene.hull === "ship" ? 58 : 34);
      if (page.located) this.spread(paper, flight, time, believed, scale, at);
      else this.headings(paper, flight, time, believed, at, length);
      this.hull(paper, truth, at, length); paper.fillStyle = colours.true; paper.globalAlpha = 0.35; paper.fill(); paper.globalAlpha = 1;
      paper.strokeStyle = colours.true; paper.lineWidth = 1.6; paper.stroke();
      this.hull(paper, believed, at, length); paper.strokeStyle = colours.believed; paper.lineWidth = 1.8; paper.stroke();
      const factor = length / (scene.size * scale);
      this.furniture(paper, width, height, scale, scene.hull !== "dot" && factor > 1.05 ? `vehicle drawn ${number(factor, 2)}×` : "");
    }
    track(paper, array, i, now, at, stroke, thickness) {
      const points = [];
      for (let j = 0; j <= i; j++) { const p = row(array, j); points.push(at(p[0], p[1])); }
      points.push(at(now[0], now[1]));
      trace(paper, points); paper.strokeStyle = stroke; paper.lineWidth = thickness; paper.stroke();
    }
    hull(paper, pose, at, length) {
      const [x, y] = at(pose[0], pose[1]), c = Math.cos(pose[5]), s = Math.sin(pose[5]);
      trace(paper, HULLS[scene.hull].map(([a, b]) => [x + length * (a * s + b * c), y - length * (a * c - b * s)]), true);
    }
    /** Twice the standard deviation, and the members, about a believed position. */
    spread(paper, flight, time, believed, scale, at) {
      const [x, y] = at(believed[0], believed[1]);
      if (flight.covariance) {
        const L = root(between(flight.covariance, time), k);
        trace(paper, TURN.map(([a, b]) => [x + 2 * scale * L[0] * a, y - 2 * scale * (L[k] * a + L[k + 1] * b)]), true);
        paper.fillStyle = colours.band; paper.fill(); paper.strokeStyle = colours.believed; paper.lineWidth = 1; paper.stroke();
      }
      paper.fillStyle = colours.member;
      for (const off of cloud(flight, time) ?? []) { dot(paper, x + off[0] * scale, y - off[1] * scale, 1.7); paper.fill(); }
    }
    /** Twice the standard deviation of a heading, and the members' headings, as rays, magnified. */
    headings(paper, flight, time, believed, at, length) {
      if (page.focus[0][0] !== "heading") return;
      const [x, y] = at(believed[0], believed[1]), far = 1.6 * length;
      const ray = (angle) => [x + far * Math.sin(angle), y - far * Math.cos(angle)];
      const sd = flight.covariance ? Math.sqrt(between(flight.covariance, time)[0]) : 0, half = (2 * sd * 10 * Math.PI) / 180;
      if (half > 0) {
        trace(paper, [[x, y], ...Array.from({ length: 17 }, (_, j) => ray(believed[5] + half * (j / 8 - 1)))], true);
        paper.fillStyle = colours.band; paper.fill();
      }
      paper.strokeStyle = colours.member; paper.lineWidth = 0.8;
      for (const off of cloud(flight, time) ?? []) { trace(paper, [[x, y], ray(believed[5] + (off[0] * 10 * Math.PI) / 180)]); paper.stroke(); }
    }
    grid(paper, width, height, scale, [x0, y0]) {
      const step = round125(70 / scale);
      paper.strokeStyle = colours.grid; paper.lineWidth = 1; paper.beginPath();
      const gap = step * scale;
      for (let x = ((x0 % gap) + gap) % gap; x < width; x += gap) { paper.moveTo(x, 0); paper.lineTo(x, height); }
      for (let y = ((y0 % gap) + gap) % gap; y < height; y += gap) { paper.moveTo(0, y); paper.lineTo(width, y); }
      paper.stroke();
    }
    furniture(paper, width, height, scale, words) {
      const bar = round125(60 / scale), x = 14, y = height - 14;
      paper.strokeStyle = paper.fillStyle = colours.ink; paper.lineWidth = 1.5;
      trace(paper, [[x, y - 4], [x, y], [x + bar * scale, y], [x + bar * scale, y - 4]]); paper.stroke();
      paper.font = "12px system-ui, sans-serif"; paper.textAlign = "left";
      paper.fillText(`${number(bar)} m${words ? `   ·   ${words}` : ""}`, x, y - 9);
      const north = [width - 20, height - 16];
      trace(paper, [[north[0], north[1] - 26], [north[0] + 5, north[1] - 12], [north[0], north[1] - 15], [north[0] - 5, north[1] - 12]], true); paper.fill();
      paper.textAlign = "center"; paper.fillText("N", north[0], north[1]);
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
      const shown = [scene.path, ...flights.map((f) => f.true)].flatMap((array) =>
        Array.from({ length: Math.min(array.rows, 40) }, (_, i) => this.place(row(array, Math.floor((i * (array.rows - 1)) / Math.max(Math.min(array.rows, 40) - 1, 1))))));
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
      for (let i = 0; i < scene.obstacles.rows; i++) {
        const [n, e, r] = row(scene.obstacles, i), up = floor - extent.low[2] + 0.12 * extent.span;
        const tower = new THREE.Mesh(new THREE.CylinderGeometry(r, r, up, 40),
          new THREE.MeshLambertMaterial({ color: colours.obstacle, transparent: true, opacity: 0.42, depthWrite: false }));
        tower.position.set(e, -floor + up / 2, -n); this.scene.add(tower);
      }
      const line = (array, stroke, thickness, dashed) => {
        const points = [];
        for (let i = 0; i < array.rows; i++) { const p = this.place(row(array, i)); points.push(p.x, p.y, p.z); }
        const made = new THREE.Line2(new THREE.LineGeometry().setPositions(points),
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
        HULLS.aircraft.forEach(([a, b], i) => (i ? wing.lineTo(b * length, a * length) : wing.moveTo(b * length, a * length)));
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
      const axis = { "north position": [0, 0, -1], "east position": [1, 0, 0], "depth": [0, -1, 0], "altitude": [0, 1, 0] };
      const axes = page.focus.map(([name]) => axis[name] ?? [0, 0, 0]);
      this.ellipsoid.visible = Boolean(flight.covariance) && page.placed;
      if (this.ellipsoid.visible) {
        const L = root(between(flight.covariance, time), k), columns = [0, 1, 2].map((c) => {
          const v = new THREE.Vector3();
          for (let r = 0; r < k; r++) if (c < k) v.addScaledVector(new THREE.Vector3(...axes[r]), 2 * L[r * k + c]);
          return v.lengthSq() > 0 ? v : new THREE.Vector3(c === 0 ? 1e-4 : 0, c === 1 ? 1e-4 : 0, c === 2 ? 1e-4 : 0);
        });
        this.ellipsoid.matrix.makeBasis(...columns).setPosition(this.believed.position);
      }
      this.fill(this.members, (cloud(flight, time) ?? []).map((off) => off.reduce((p, v, j) => p.addScaledVector(new THREE.Vector3(...axes[j]), v), this.believed.position.clone())));
      const fixes = [];
      for (let j = 0; j <= i; j++) {
        const fix = row(flight.fix, j);
        if (page.placed && fix.slice(0, Math.min(k, 2)).every(Number.isFinite)) fixes.push(fix.reduce((p, v, m) => p.addScaledVector(new THREE.Vector3(...axes[m]), Number.isFinite(v) ? v : 0), this.place(row(flight.true, j))));
      }
      this.fill(this.fixes, fixes);
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
      const array = points.geometry.attributes.position;
      const count = Math.min(places.length, array.count);
      for (let i = 0; i < count; i++) array.setXYZ(i, places[i].x, places[i].y, places[i].z);
      array.needsUpdate = true; points.geometry.setDrawRange(0, count);
    }
  }

  // --- the close-up: what is believed, about the truth ----------------------------------------------------------

  /** Which way the second of what is shown close up grows, in pixels: depth to the bottom, all else to the top. */
  const DOWN = page.focus[1]?.[0] === "depth" ? 1 : -1;
  function closeUp(flight, time) {
    const { paper, width, height } = sized(element("belief"));
    const error = between(flight.error, time), members = cloud(flight, time), fix = lastFix(flight, time);
    const cov = flight.covariance ? between(flight.covariance, time) : null;
    paper.font = "11px system-ui, sans-serif";
    (k === 1 ? bell : target)(paper, width, height, error, cov, members, fix);
    paper.globalAlpha = 1;
  }
  function target(paper, width, height, error, cov, members, fix) {
    const sd = cov ? [Math.sqrt(Math.max(cov[0], 0)), Math.sqrt(Math.max(cov[k + 1], 0))] : [0, 0];
    const reach = round125(Math.max(1.05 * Math.max(Math.abs(error[0]) + 2 * sd[0], Math.abs(error[1]) + 2 * sd[1]), 1e-3));
    const cx = width / 2, cy = height / 2, scale = (Math.min(width, height) / 2 - 12) / reach;
    const at = (a, b) => [cx + a * scale, cy + DOWN * b * scale];
    paper.strokeStyle = colours.edge; paper.lineWidth = 1;
    for (const r of [0.5, 1]) { dot(paper, cx, cy, r * reach * scale); paper.stroke(); }
    trace(paper, [at(-reach, 0), at(reach, 0)]); paper.stroke();
    trace(paper, [at(0, -reach), at(0, reach)]); paper.stroke();
    paper.fillStyle = colours.muted; paper.textAlign = "left";
    paper.fillText(`${number(reach)} ${page.focus[0][1]}`, cx + 4, cy - reach * scale + 1);
    const [x, y] = at(error[0], error[1]);
    if (cov) {
      const L = root(cov, k);
      trace(paper, TURN.map(([a, b]) => at(error[0] + 2 * L[0] * a, error[1] + 2 * (L[k] * a + L[k + 1] * b))), true);
      paper.fillStyle = colours.band; paper.fill(); paper.strokeStyle = colours.believed; paper.lineWidth = 1.5; paper.stroke();
    }
    paper.fillStyle = colours.member;
    for (const off of members ?? []) { dot(paper, ...at(error[0] + off[0], error[1] + off[1]), 1.8); paper.fill(); }
    if (fix) {
      paper.globalAlpha = Math.max(0.2, 1 - fix.age / 4); paper.strokeStyle = colours.measurement; paper.lineWidth = 2;
      const far = Math.hypot(fix.off[0], fix.off[1]) / reach;
      if (far <= 1) cross(paper, ...at(fix.off[0], fix.off[1]), 4.5);
      else {  // beyond the rim: an arrow that points to it
        const [tx, ty] = at(fix.off[0] / far, fix.off[1] / far), a = Math.atan2(ty - cy, tx - cx), fin = (turn) => [tx - 8 * Math.cos(a + turn), ty - 8 * Math.sin(a + turn)];
        trace(paper, [fin(0.5), [tx, ty], fin(-0.5)]); paper.stroke();
      }
      paper.globalAlpha = 1;
    }
    dot(paper, x, y, 3.5); paper.fillStyle = colours.believed; paper.fill();
    dot(paper, cx, cy, 4.5); paper.fillStyle = colours.true; paper.fill();
  }
  function bell(paper, width, height, error, cov, members, fix) {
    const sd = cov ? Math.sqrt(Math.max(cov[0], 0)) : 0, base = height - 24;
    const reach = round125(Math.max(Math.abs(error[0]) + 3 * sd, fix ? Math.abs(fix.off[0]) : 0, 1e-3));
    const x = (v) => width / 2 + (v / reach) * (width / 2 - 12);
    paper.strokeStyle = colours.edge; paper.lineWidth = 1; trace(paper, [[8, base], [width - 8, base]]); paper.stroke();
    paper.fillStyle = colours.muted; paper.textAlign = "center";
    for (const v of [-reach, 0, reach]) paper.fillText(`${v > 0 ? "+" : ""}${number(v)}${page.focus[0][1]}`, Math.max(18, Math.min(width - 18, x(v))), height - 8);
    if (sd > 0) {
      const curve = Array.from({ length: 81 }, (_, i) => { const z = (i - 40) / 10; return [x(error[0] + z * sd), base - (base - 26) * Math.exp(-0.5 * z * z)]; });
      trace(paper, [[curve[0][0], base], ...curve, [curve[80][0], base]], true);
      paper.fillStyle = colours.band; paper.fill(); trace(paper, curve); paper.strokeStyle = colours.believed; paper.lineWidth = 1.5; paper.stroke();
    }
    paper.strokeStyle = colours.member; paper.lineWidth = 1;
    for (const off of members ?? []) { trace(paper, [[x(error[0] + off[0]), base], [x(error[0] + off[0]), base - 14]]); paper.stroke(); }
    paper.lineWidth = 2;
    paper.strokeStyle = colours.believed; trace(paper, [[x(error[0]), 18], [x(error[0]), base]]); paper.stroke();
    paper.strokeStyle = colours.true; trace(paper, [[x(0), 10], [x(0), base]]); paper.stroke();
    if (fix) { paper.globalAlpha = Math.max(0.2, 1 - fix.age / 4); paper.strokeStyle = colours.measurement; cross(paper, x(fix.off[0]), base - 30, 4.5); }
  }

  // --- charts ---------------------------------------------------------------------------------------------------

  let charts = [];
  function layCharts() {
    const shelf = element("charts"), flight = current();
    charts.forEach((chart) => chart.plot.destroy());
    shelf.replaceChildren();
    charts = flight.charts.map((chart) => {
      const box = document.createElement("div"), title = document.createElement("h2"), name = document.createElement("span");
      const value = document.createElement("output"), room = document.createElement("div");
      name.textContent = chart.title + (chart.unit ? `  [${chart.unit}]` : ""); title.append(name, value);
      room.className = "plot"; room.setAttribute("role", "img"); room.setAttribute("aria-label", `${chart.title} over time on ${flight.estimator}`);
      box.append(title, room); shelf.append(box);
      return { chart, box, room, value };
    });
    for (const each of charts) plot(each, flight);
  }
  function plot(each, flight) {
    const { chart, room } = each, rows = chart.believed?.rows ?? chart.true.rows;
    const plain = (array) => (array ? Array.from(array.values, (v) => (Number.isFinite(v) ? v : null)) : new Array(rows).fill(null));
    const time = Array.from({ length: rows }, (_, i) => i * dt), believed = plain(chart.believed), band = plain(chart.two_sigma);
    const high = band.map((v, i) => (v === null ? null : v)), low = band.map((v) => (v === null ? null : -v));
    const score = chart.title.startsWith("Score"), zero = chart.two_sigma || chart.measurements || chart.title.endsWith("error");
    const true_ = chart.true ? plain(chart.true) : zero ? new Array(rows).fill(0) : new Array(rows).fill(null);
    const sizes = [...believed, ...band, ...true_].filter((v) => v !== null).map(Math.abs).sort((a, b) => a - b);
    const biggest = Math.max(sizes[Math.floor(0.995 * (sizes.length - 1))] || 0, 1e-3);
    const range = score ? [Math.min(-0.1, ...believed), Math.max(1.05, ...believed)] : [-1.2 * biggest, 1.2 * biggest];
    const power = 10 ** Math.floor(Math.log10(biggest)), tick = power * [5, 2, 1].find((f) => f * power <= biggest * 1.000001);
    const axis = { stroke: () => colours.muted, grid: { stroke: () => colours.grid, width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    const options = {
      width: Math.max(room.clientWidth, 50), height: Math.max(room.clientHeight, 50), legend: { show: false }, padding: [6, 22, 0, 0],
      cursor: { drag: { x: false, y: false }, y: false, points: { show: false } },
      scales: { x: { time: false, range: [0, duration] }, y: { range } },
      axes: [{ ...axis, size: 20, gap: 2, values: (_, at) => at.map((v) => `${v} s`) }, { ...axis, size: 44, gap: 3, splits: () => (score ? [0, 0.5, 1] : [-tick, 0, tick]), values: (_, at) => at.map((v) => number(v)) }],
      bands: [{ series: [1, 2], fill: () => colours.band }],
      series: [{},
        { stroke: "transparent", points: { show: false } }, { stroke: "transparent", points: { show: false } },
        { stroke: () => colours.measurement, width: 0, paths: () => null, points: { show: true, size: 3, fill: () => colours.measurement, stroke: () => colours.measurement } },
        { stroke: () => colours.true, width: chart.true ? 2.5 : 1.2, points: { show: false } },
        { stroke: () => (score ? colours.true : colours.believed), width: 1.5, points: { show: false } }],
    };
    each.plot = new uPlot(options, [time, high, low, plain(chart.measurements), true_, believed], room);
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
    for (const { chart, plot, veil, value } of charts) {
      veil.style.left = `${plot.valToPos(Math.min(time, duration), "x")}px`;
      const i = stepAt(flight, time), v = chart.believed ? chart.believed.values[i] : NaN, s = chart.two_sigma?.values[i];
      value.textContent = Number.isFinite(v) ? number(v) + (Number.isFinite(s) ? ` ± ${number(s, 2)}` : "") : chart.believed ? "" : "not estimated";
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
    layLegend(); layCharts(); tell();
  }
  function tell() {
    const flight = current(), i = stepAt(flight, state.time);
    const words = page.focus.map(([name, unit], j) => `${name} error ${number(row(flight.error, i)[j])} ${unit}`).join(", ");
    const told = `${flight.estimator} at ${state.time.toFixed(1)} s: ${words}. Final score ${number(flight.score)}${flight.end ? `, ${flight.end}` : ""}.`;
    element("status").textContent = told; element("view").setAttribute("aria-label", told); element("belief").setAttribute("aria-label", `Belief about the truth, close up. ${told}`);
  }
  function layLegend() {
    const flight = current(), line = (stroke, extra = "") => `<line x1="0" y1="6" x2="22" y2="6" stroke="var(--${stroke})" ${extra}/>`;
    const items = [[line("true", 'stroke-width="3"'), "true vehicle and track"]];
    items.push([line("believed", 'stroke-width="2"'), page.located || page.scene.space ? `believed by ${flight.estimator}` : `heading believed by ${flight.estimator}; its place is not estimated`]);
    if (flight.covariance) items.push(['<ellipse cx="11" cy="6" rx="10" ry="5" fill="var(--band)" stroke="var(--believed)"/>', page.located || page.scene.space ? "believed position ± 2σ" : "believed heading ± 2σ, 10×"]);
    if (flight.members) items.push([[4, 11, 17].map((x, i) => `<circle cx="${x}" cy="${[8, 4, 7][i]}" r="2" fill="var(--member)"/>`).join(""), `${flight.members.shape[1]} members of the ensemble`]);
    const mark = stage instanceof Space ? '<rect x="9" y="4" width="5" height="5" fill="var(--measurement)"/>' : '<path d="M7 2 15 10 M7 10 15 2" stroke="var(--measurement)" stroke-width="2"/>';
    if (flight.fix.values.some(Number.isFinite)) items.push([mark, "measurements"]);
    if (scene.path.rows) items.push([line("commanded", 'stroke-width="2" stroke-dasharray="5 4"'), "commanded path"]);
    if (scene.goal) items.push(['<circle cx="11" cy="6" r="5" fill="none" stroke="var(--goal)" stroke-width="2"/>', "goal"]);
    if (scene.obstacles.rows) items.push(['<rect x="4" y="0" width="14" height="12" fill="var(--obstacle)" opacity="0.5"/>', "obstacle"]);
    element("legend").replaceChildren(...items.map(([icon, words]) => {
      const item = document.createElement("li"), text = document.createElement("span");
      item.innerHTML = `<svg viewBox="0 0 22 12" aria-hidden="true">${icon}</svg>`; // icons are ours; words of others go in as text
      text.textContent = words; item.append(text);
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
  const where = k === 1 ? `${page.focus[0][0]}, off the truth` : `${page.focus[0][0]} → and ${page.focus[1][0]} ${DOWN > 0 ? "↓" : "↑"} off the truth`;
  element("close-title").textContent = `Close-up: ${where}`;
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

  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { look(); stage.theme(); layCharts(); state.dirty = true; });
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


// The scene in three dimensions, with WebGL.

class Space {
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.camera = new THREE.PerspectiveCamera(40, 1, extent.span * 0.002, extent.span * 30);
    // The wheel scrolls the page, and zooms with Ctrl or Cmd: the controls must not see it without.
    canvas.addEventListener("wheel", (event) => { if (!event.ctrlKey && !event.metaKey) event.stopImmediatePropagation(); }, { capture: true });
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.addEventListener("change", () => { state.dirty = true; });
    this.controls.addEventListener("start", () => { this.moved = true; });
    // One finger scrolls the page, two turn and zoom: the browser must not scroll with those.
    canvas.style.touchAction = "pan-y"; this.controls.touches.ONE = null;
    canvas.addEventListener("touchmove", (event) => { if (event.touches.length > 1) event.preventDefault(); }, { passive: false });
    this.far = this.place(extent.middle);
    this.controls.target.copy(this.far);
    const [north, east] = alongPath();
    // A dive is seen from the side, so that down in the water is down in the picture; a flight from above.
    const from = scene.surface === null ? new THREE.Vector3(0.62, 0.62, 0.85) : new THREE.Vector3(north - 0.3 * east, 0.28, east + 0.3 * north);
    this.camera.position.copy(this.far).add(from);
    this.build();
  }
  /** As near as all of path and flights is seen, beside the close-up and from where the camera looks. */
  fit() {
    const away = this.camera.position.clone().sub(this.controls.target).normalize(), [right, top] = aside();
    const some = (array) => rows(array).filter((_, i) => i % Math.ceil(array.rows / 40) === 0 || i === array.rows - 1);
    const framed = [scene.path, ...flights.map((f) => f.true)].flatMap((array) => some(array).map(this.place));
    for (const [n, e] of [scene.low, scene.high]) framed.push(...[this.floor, scene.surface ?? this.floor].map((down) => this.place([n, e, down])));
    const left = 64, low = top + 30, wide = this.width - right - left - 56, tall = this.height - low - 62;
    let distance = 3 * extent.span;
    this.controls.target.copy(this.far);
    for (let i = 0; i < 16; i++) { // the middle of what is seen moves to that of the frame, and its size to the frame's
      this.camera.position.copy(this.controls.target).addScaledVector(away, distance);
      this.camera.lookAt(this.controls.target); this.camera.updateMatrixWorld();
      const seen = framed.map((point) => this.onScreen(point)), ends = [0, 1].map((c) => [Math.min(...seen.map((p) => p[c])), Math.max(...seen.map((p) => p[c]))]);
      const metres = (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360)) / this.height, matrix = this.camera.matrixWorld;
      this.controls.target.addScaledVector(new THREE.Vector3().setFromMatrixColumn(matrix, 0), metres * ((ends[0][0] + ends[0][1]) / 2 - left - wide / 2));
      this.controls.target.addScaledVector(new THREE.Vector3().setFromMatrixColumn(matrix, 1), -metres * ((ends[1][0] + ends[1][1]) / 2 - low - tall / 2));
      distance *= Math.max((ends[0][1] - ends[0][0]) / Math.max(wide, 60), (ends[1][1] - ends[1][0]) / Math.max(tall, 60));
    }
    this.camera.position.copy(this.controls.target).addScaledVector(away, distance);
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
    const length = (this.length = Math.max(scene.size, 0.05 * extent.span));
    this.parts = LOOKS.map((look, j) => ({
      tracks: flights.map((f) => ({ true: line(f.true, colours.true, j ? 2 : 3.5, j), estimate: line(f.believed, colours[look.colour], 2, j) })),
      true: this.vehicle(length, colours.true, false), estimate: this.vehicle(length * 1.04, colours[look.colour], true),
      ellipsoid: this.ellipsoid(colours[look.colour]), members: this.points(200, colours[look.member], 4), fixes: this.points(Math.max(...flights.map((f) => f.true.rows)), colours[look.fix], 4),
    }));
    this.drop = new THREE.Line2(new THREE.LineGeometry().setPositions([0, 0, 0, 0, scene.surface === null ? -1 : 1, 0]), new THREE.LineMaterial({ color: colours.muted, linewidth: 1.2 }));
    this.drop.frustumCulled = false; this.scene.add(this.drop);
  }
  ellipsoid(fill) {
    const made = new THREE.Mesh(new THREE.SphereGeometry(1, 32, 20), new THREE.MeshBasicMaterial({ color: fill, transparent: true, opacity: 0.25, depthWrite: false }));
    made.matrixAutoUpdate = false; made.frustumCulled = false; this.scene.add(made);
    return made;
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
  draw(time) {
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    if (this.width !== width || this.height !== height) {
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / Math.max(height, 1); this.camera.updateProjectionMatrix();
      const [right, top] = aside();
      this.camera.setViewOffset(width, height, right / 2, -top / 2, width, height);
      this.width = width; this.height = height;
      if (!this.moved && !this.followed) this.fit();
    }
    const parts = shown();
    this.parts.forEach((part, j) => this.part(part, parts[j]?.flight, time));
    const first = parts[0].flight, truth = between(first.true, time);
    this.drop.position.copy(this.parts[0].true.position);
    this.drop.scale.set(1, Math.max(Math.abs((scene.surface ?? this.floor) - truth[2]), 1e-6), 1);
    this.look(this.parts[0].true.position);
    this.renderer.render(this.scene, this.camera);
    this.label();
  }
  /** Tracks, vehicle, estimate and its spread of one of the two estimators; hidden without a flight. */
  part(part, flight, time) {
    part.tracks.forEach((each, j) => {
      const now = flights[j] === flight ? stepAt(flight, time) : 0;
      each.true.visible = each.estimate.visible = now > 0;
      each.true.geometry.instanceCount = each.estimate.geometry.instanceCount = now;
    });
    for (const each of [part.true, part.estimate, part.members]) each.visible = Boolean(flight);
    this.fill(part.fixes, flight && data.located ? fixes(flight, stepAt(flight, time)) : []);
    part.ellipsoid.visible = Boolean(flight?.root) && data.located;
    if (!flight) return;
    const estimate = between(flight.believed, time), size = state.follow ? Math.max(scene.size / this.length, 0.05) : 1;
    this.put(part.true, between(flight.true, time)); this.put(part.estimate, estimate);
    part.true.scale.setScalar(size); part.estimate.scale.setScalar(size);
    this.fill(part.members, cloud(flight, time).map((off) => shifted(estimate, off)));
    if (!part.ellipsoid.visible) return;
    const L = between(flight.root, time), thin = [[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]];
    const columns = thin.map((least, c) => new THREE.Vector3(...(c < k ? this.place(shifted([0, 0, 0], focus.map((_, r) => 2 * L[r * k + c]))).toArray() : least)));
    columns.forEach((column, c) => { if (!column.lengthSq()) column.set(...thin[c]); });
    part.ellipsoid.matrix.makeBasis(...columns).setPosition(part.estimate.position);
  }
  /** Follow the vehicle, or show the whole again. */
  look(now) {
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
  /** Turn about the vertical and the horizontal [rad], and come nearer by a factor: what buttons do. */
  turn(around, up, nearer) {
    const away = this.camera.position.clone().sub(this.controls.target), level = Math.hypot(away.x, away.z);
    const yaw = Math.atan2(away.x, away.z) + around, pitch = Math.max(-1.2, Math.min(1.5, Math.atan2(away.y, level) + up)), far = away.length() / nearer;
    this.camera.position.copy(this.controls.target).add(new THREE.Vector3(Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch)).multiplyScalar(far));
    this.moved = true; state.dirty = true;
  }
  pixels(place) {
    return this.onScreen(this.place(place));
  }
  onScreen(point) {
    const p = point.clone().project(this.camera);
    return p.z > 1 ? [NaN, NaN] : [(p.x + 1) * 0.5 * this.width, (1 - p.y) * 0.5 * this.height];
  }
  /** Pixels of a place in each view, of which there is one. */
  screen(place) { return [this.pixels(place)]; }
  /** Direction on the screen [rad clockwise from up] of a level vector. */
  bearing([north, east]) {
    const length = Math.hypot(north, east) || 1, [x0, y0] = this.pixels(extent.middle);
    const [x, y] = this.pixels(extent.middle.map((v, c) => v + 0.05 * extent.span * ([north, east, 0][c] / length)));
    return Math.atan2(x - x0, y0 - y);
  }
  /** Axes with values at the edges of the box round the tracks that are nearest to the eye, and the surface's name. */
  label() {
    const { paper } = sized(element("marks")), low = [...extent.low], high = [...extent.high];
    if (scene.surface !== null) { low[2] = scene.surface; high[2] = this.floor; } else high[2] = this.floor;
    const flat = [0, 1].map((c) => (high[c] - low[c] < 0.1 * extent.span ? 0.1 * extent.span : 0));
    flat.forEach((wide, c) => { low[c] -= wide; high[c] += wide; });
    const corner = (north, east, down) => [north ? high[0] : low[0], east ? high[1] : low[1], down ? high[2] : low[2]];
    const nearest = (edges) => edges.map((ends) => ends.map((p) => this.pixels(p))).map((p, i) => ({ ends: edges[i], y: p[0][1] + p[1][1], x: p[0][0] + p[1][0] }));
    const lowest = (edges) => nearest(edges).reduce((a, b) => (b.y > a.y ? b : a)).ends, left = (edges) => nearest(edges).reduce((a, b) => (b.x < a.x ? b : a)).ends;
    this.axis(paper, "north [m]", lowest([0, 1].map((e) => [corner(0, e, 1), corner(1, e, 1)])), 0, (v) => v);
    if (WIDE) this.axis(paper, "east [m]", lowest([0, 1].map((n) => [corner(n, 0, 1), corner(n, 1, 1)])), 1, (v) => v);
    this.axis(paper, `${HEIGHT.word} [m]`, left([0, 1].flatMap((n) => [0, 1].map((e) => [corner(n, e, 0), corner(n, e, 1)]))), 2, HEIGHT.of);
    if (scene.surface === null) return;
    const rim = [[0, 0], [1, 0], [1, 1], [0, 1]].map(([n, e]) => this.pixels(corner(n, e, 0)));
    draw(paper, [...rim, rim[0]], { stroke: colours.true, width: 1.5 });
    write(paper, "water surface", Math.max(...rim.map(([x]) => x)), Math.min(...rim.map(([, y]) => y)) - 6, "right", colours.ink);
  }
  axis(paper, name, [from, to], c, value) {
    const [a, b] = [value(from[c]), value(to[c])], ends = [this.pixels(from), this.pixels(to)], long = Math.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]);
    if (!(long > 30)) return;
    draw(paper, ends, { stroke: colours.muted, width: 1.2 });
    const middle = [0, 1].map((j) => (ends[0][j] + ends[1][j]) / 2), centre = this.pixels(extent.middle);
    let [nx, ny] = [(ends[1][1] - ends[0][1]) / long, (ends[0][0] - ends[1][0]) / long]; // away from the box
    if (nx * (middle[0] - centre[0]) + ny * (middle[1] - centre[1]) < 0) [nx, ny] = [-nx, -ny];
    const align = Math.abs(nx) < 0.35 ? "center" : nx > 0 ? "left" : "right", step = round125((Math.abs(b - a) * (c === 2 ? 34 : 58)) / long);
    for (const v of levels(Math.min(a, b), Math.max(a, b), step)) {
      const place = from.map((f, j) => (j === c ? f + ((to[c] - f) * (v - a)) / (b - a) : f)), [x, y] = this.pixels(place);
      draw(paper, circle([x, y], 1.8), { fill: colours.muted });
      write(paper, number(v), x + 8 * nx, y + 4 + 11 * ny, align);
    }
    const [x, y] = c === 2 ? [ends[0][0] - 40, ends[0][1] - 12] : [middle[0] + (8 + 36 * Math.abs(nx)) * nx, middle[1] + 4 + 25 * ny];
    const wide = paper.measureText(name).width, before = c === 2 || align === "left" ? 0 : align === "right" ? wide : wide / 2;
    write(paper, name, Math.max(4, Math.min(x - before, this.width - wide - 4)), y, "left", colours.ink); // within the scene
  }
}


// Controls: clock, choice of estimators, keys, and what stands in words.

function go(time) { state.time = Math.max(0, Math.min(duration, time)); state.dirty = true; }
function play(on) {
  if (on && state.time >= duration) state.time = 0;
  state.playing = on; state.dirty = true;
  element("play").textContent = on ? "❚❚" : "►"; element("play").setAttribute("aria-label", on ? "Pause" : "Play");
  if (!on) report();
}
function follow(on) { state.follow = on; state.dirty = true; element("follow").setAttribute("aria-pressed", String(on)); }
/** Show an estimator, and a second one over it; -1 or the same: none. */
function choose(first, second = state.second) {
  if (!(first in flights)) return;
  state.first = first; state.second = second in flights && second !== first ? second : -1; state.dirty = true;
  [...element("estimators").querySelectorAll("button")].forEach((button, i) => {
    button.setAttribute("aria-pressed", String(i === first)); button.classList.toggle("second", i === state.second);
  });
  [...element("second").options].forEach((option) => { option.disabled = Number(option.value) === first; });
  element("second").value = String(state.second);
  element("overlay-note").hidden = !overlaid();
  layLuck(); layCosts(); layLegend(); layCharts(); layAmbient(); report();
}
/** Where an estimate scores more than the truth, how that can be. */
function layLuck() {
  const best = flights.find(({ estimator }) => estimator === "truth"), luckier = shown().filter(({ flight }) => best && flight.scored && flight.score > best.score);
  element("luck").hidden = !luckier.length;
  element("luck").textContent = luckier.map(({ flight }) => `Here ${flight.estimator} scores ${(flight.score - best.score).toFixed(3)} more than the truth.`).join(" ")
    + " In one episode that can be chance: an error of the estimate may turn the vehicle the right way, or spare its actuators. Means over many seeds decide.";
}
function layCosts() {
  const other = overlaid() ? flights[state.second].costs : [];
  element("costs").replaceChildren(...flights[state.first].costs.map(({ label, value, unit, meaning }) => {
    const item = document.createElement("li"), amount = document.createElement("b"), beside = other.find((cost) => cost.label === label);
    amount.textContent = beside ? value : `${value}${unit ? ` ${unit}` : ""}`; item.title = meaning; item.append(`${label} `, amount);
    if (beside) { const more = document.createElement("b"); more.className = "second"; more.textContent = beside.value; item.append(" | ", more, unit ? ` ${unit}` : ""); }
    return item;
  }));
}
/** Error and score of the estimators shown, at the clock's time. */
function layErrors() {
  element("errors").replaceChildren(...shown().map(({ flight, look }) => {
    const item = document.createElement("li"), name = document.createElement("b"), i = stepAt(flight, state.time);
    name.textContent = flight.estimator; name.style.color = `var(--${look.colour})`;
    item.append(name, ` ${errorInWords(flight, i)}`);
    return item;
  }));
}
/** The state of the page for a screen reader: at rest only, for each change would be read aloud. */
function report() {
  const words = shown().map(({ flight }) => `${flight.estimator} at ${clock(state.time)}${k ? `: estimate minus truth ${errorInWords(flight, stepAt(flight, state.time))}` : ""}. Final ${scoreOf(flight)}${flight.end ? `, ${flight.end}` : ""}.`).join(" ");
  element("status").textContent = words;
  if (scene) { element("view").setAttribute("aria-label", words); element("belief").setAttribute("aria-label", `Close-up of the error. ${words}`); }
}
const line = (stroke, extra = "") => `<line x1="0" y1="6" x2="22" y2="6" stroke="var(--${stroke})" ${extra}/>`;
const round = (r, extra) => `<circle cx="11" cy="6" r="${r}" ${extra}/>`;
const oval = (look) => `<ellipse cx="11" cy="6" rx="10" ry="5" fill="var(--${look.band})" stroke="var(--${look.colour})"/>`;
const dots = (fill) => [[4, 8], [11, 4], [17, 7]].map(([x, y]) => `<circle cx="${x}" cy="${y}" r="2" fill="var(--${fill})"/>`).join("");
const mark = ({ fix }) => `<path d="M7 2 15 10 M7 10 15 2" stroke="var(--${fix})" stroke-width="2"/>`;
const DASH = 'stroke-width="2" stroke-dasharray="5 4"';
const ICONS = { // in the order of the legend
  true: line("true", 'stroke-width="3"'), believed: line("believed", 'stroke-width="2"'), ellipse: oval(LOOKS[0]), cloud: dots("member"),
  true2: line("true", DASH), believed2: line("second", DASH), ellipse2: oval(LOOKS[1]), cloud2: dots("second"),
  fix: mark(LOOKS[0]), fix2: mark(LOOKS[1]), path: line("commanded", DASH),
  fairway: '<rect x="1" y="2" width="20" height="8" fill="var(--true)" fill-opacity="0.12" stroke="var(--muted)"/>',
  goal: round(5, 'fill="none" stroke="var(--goal)" stroke-width="2"'), obstacle: round(6, 'fill="var(--obstacle)" opacity="0.5"'),
};
function layLegend() {
  if (!scene) return;
  const labels = {};
  shown().forEach(({ flight }, j) => {
    const own = { ...flight.legend }, suffix = j ? "2" : "";
    if (!data.located) {
      own.believed = `${focus[0].name} estimated by ${flight.estimator}; its place is not estimated`;
      if (flight.fix.values.some(Number.isFinite)) own.fix = `measured ${focus[0].name}`;
      if (flight.root) own.ellipse = `${focus[0].name} ±2σ, 10 times magnified`;
    }
    for (const kind of ["true", "believed", "ellipse", "cloud", "fix"]) if (own[kind]) labels[kind + suffix] = overlaid() && !own[kind].includes(flight.estimator) ? `${own[kind]}, ${flight.estimator}` : own[kind];
    if (!j) for (const kind of ["path", "fairway", "goal", "obstacle"]) labels[kind] = own[kind];
  });
  element("legend").replaceChildren(...Object.keys(ICONS).filter((kind) => labels[kind]).map((kind) => {
    const item = document.createElement("li"), text = document.createElement("span");
    const icon = kind.startsWith("fix") && stage instanceof Space ? `<rect x="9" y="4" width="5" height="5" fill="var(--${LOOKS[Number(kind === "fix2")].fix})"/>` : ICONS[kind];
    item.innerHTML = `<svg viewBox="0 0 22 12" aria-hidden="true">${icon}</svg>`; // icons are ours; words of others go in as text
    text.textContent = labels[kind]; item.append(text);
    return item;
  }));
}
/** Arrows of north, wind, waves and current, which turn with the view. */
function layAmbient() {
  if (!scene) return;
  const north = { name: "North", vector: null };
  element("ambient").replaceChildren(...[north, ...flights[state.first].ambient].map((each) => {
    const item = document.createElement("li");
    item.innerHTML = '<svg viewBox="-9 -9 18 18" aria-hidden="true"><path d="M0 8V-7M-4-2 0-8 4-2" fill="none" stroke="currentColor" stroke-width="2"/></svg><span></span>';
    return Object.assign(item, { each });
  }));
}
function drawAmbient(time) {
  for (const item of element("ambient").children) {
    const { name, unit, vector } = item.each, way = vector ? between(vector, time) : [1, 0], value = Math.hypot(...way);
    const bearing = (turn) => `${String(Math.round((Math.atan2(way[1], way[0]) * 180) / Math.PI + 360 + turn) % 360).padStart(3, "0")}°`;
    const direction = name === "Current" ? `to ${bearing(0)}` : `from ${bearing(180)}`;
    item.firstChild.style.transform = `rotate(${stage.bearing(way)}rad)`;
    item.lastChild.textContent = vector ? `${name} ${value.toFixed(value < 1 ? 2 : 1)} ${unit} ${direction}` : name;
  }
}

/** What the colours of the scene mean, in one line. */
function layCaption() {
  const parts = [["Blue", ": where it is. "], ["Orange", `: ${data.located ? "where the filter estimates that it is" : `its ${focus[0].name}, as the filter estimates it`}. `]];
  if (scene.path.rows > 1) parts.push(["Dashed line", ": the way to follow."]);
  element("caption").replaceChildren(...parts.flatMap(([colour, text]) => [Object.assign(document.createElement("b"), { textContent: colour }), text]));
}
element("name").textContent = data.name;
element("conditions").textContent = [...(data.environment === data.name ? [] : [data.environment]), ...data.conditions].join("  ·  ");
const option = (value, text) => Object.assign(document.createElement("option"), { value, textContent: text });
element("second").append(option(-1, "none"));
flights.forEach((flight, i) => {
  const button = document.createElement("button"), score = document.createElement("small");
  button.type = "button"; button.textContent = flight.estimator; score.textContent = scoreOf(flight);
  button.title = `Key ${i + 1}; shift and ${i + 1} lays it over the first`;
  button.append(score); button.addEventListener("click", () => choose(i)); element("estimators").insertBefore(button, element("overlay"));
  element("second").append(option(i, flight.estimator));
});
element("overlay").hidden = element("choose-help").hidden = flights.length < 2;
element("second").addEventListener("change", (event) => choose(state.first, Number(event.target.value)));
for (const speed of [0.5, 1, 2, 5, 10, 20, 50, 100]) element("speed").append(option(speed, `${speed}×`));
element("speed").value = String((state.speed = [1, 2, 5, 10, 20, 50, 100].find((s) => duration / s <= 30) ?? 100));
element("time").max = duration;
element("time").addEventListener("input", (event) => go(Number(event.target.value)));
element("play").addEventListener("click", () => play(!state.playing));
element("follow").addEventListener("click", () => follow(!state.follow));
element("speed").addEventListener("change", (event) => { state.speed = Number(event.target.value); });
document.addEventListener("keydown", (event) => {
  const { tagName } = event.target, digit = /^Digit([1-9])$/.exec(event.code)?.[1];
  if (event.ctrlKey || event.metaKey || event.altKey || tagName === "SELECT" || (tagName === "BUTTON" && event.key === " ")) return;
  const jump = event.shiftKey ? 10 : 1;
  const keys = {
    " ": () => play(!state.playing), Home: () => go(0), End: () => go(duration), f: () => follow(!state.follow), F: () => follow(!state.follow),
    ArrowRight: () => go((Math.round(state.time / dt) + jump) * dt), ArrowLeft: () => go((Math.round(state.time / dt) - jump) * dt),
  };
  const chosen = () => (event.shiftKey ? choose(state.first, state.second === digit - 1 ? -1 : digit - 1) : choose(digit - 1));
  const action = keys[event.key] ?? (digit ? chosen : null);
  if (action) { event.preventDefault(); action(); if (!state.playing) report(); }
});

let stage = null;
function layStage() {
  const view = element("view");
  try {
    stage = scene.space && !data.flat ? new Space(view) : new Plan(view);
  } catch { // a canvas that was asked for one kind of context has no other
    const fresh = view.cloneNode();
    view.replaceWith(fresh);
    stage = new Plan(fresh);
    element("note").textContent = "This browser has no WebGL: the scene is drawn in two dimensions, to scale.";
  }
  const space = stage instanceof Space, turns = { left: [-0.26, 0, 1], right: [0.26, 0, 1], up: [0, 0.17, 1], down: [0, -0.17, 1], nearer: [0, 0, 1.25], farther: [0, 0, 0.8] };
  element("turns").hidden = element("orbit").hidden = !space;
  for (const [name, by] of Object.entries(turns)) element(`turn-${name}`).addEventListener("click", () => stage.turn(...by));
  const close = k === 1 ? focus[0].name : `${focus[0].name} → and ${focus[1].name} ${DOWN > 0 ? "↓" : "↑"}`;
  element("close-title").textContent = `Estimate minus truth: ${close}`;
  if (!data.placed) element("view").hidden = element("buttons").hidden = true;
  element("view").addEventListener("pointermove", (event) => {
    const box = element("view").getBoundingClientRect(), found = event.buttons ? null : nearest(event.clientX - box.left, event.clientY - box.top);
    tip(found && event, found?.lines);
  });
  element("view").addEventListener("pointerleave", () => tip());
}
/** Text of the moment whose true place is drawn nearest to a pixel; null farther than 16 pixels away. */
function nearest(x, y) {
  let best = null, least = 16;
  for (const { flight } of shown()) {
    for (let i = 0; i <= stepAt(flight, state.time); i++) {
      for (const [a, b] of stage.screen(row(flight.true, i))) {
        const distance = Math.hypot(a - x, b - y);
        if (distance < least) { least = distance; best = { flight, i }; }
      }
    }
  }
  if (!best) return null;
  const { flight, i } = best;
  return { lines: [`${flight.estimator} at ${clock(i * dt)}`, `true: ${placeInWords(row(flight.true, i))}`, `estimate minus truth: ${errorInWords(flight, i)}`] };
}
if (scene) { layStage(); layCaption(); }
if (!scene) { element("stage").hidden = element("follow-help").hidden = element("orbit").hidden = true; document.body.classList.add("charts-only"); }

window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { stage?.theme(); layCharts(); state.dirty = true; });
new ResizeObserver(() => {
  for (const { plot: drawn, room } of charts) drawn.setSize({ width: Math.max(room.clientWidth, 50), height: Math.max(room.clientHeight, 50) });
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
    if (stage) {
      if (data.placed) { stage.draw(state.time); drawAmbient(state.time); }
      layErrors(); closeUp(state.time);
    }
    drawCharts(state.time);
    element("time").value = state.time;
    element("time").setAttribute("aria-valuetext", clock(state.time));
    element("clock").textContent = `${state.time.toFixed(1)} / ${clock(duration)}`;
    const ended = shown().filter(({ flight }) => flight.end && state.time >= (lengthOf(flight) - 1) * dt);
    element("ended").textContent = ended.map(({ flight }) => `${overlaid() ? `${flight.estimator}: ` : ""}${flight.end} at ${clock((lengthOf(flight) - 1) * dt)}`).join("; ");
  }
  requestAnimationFrame(frame);
}

// "#t=30&estimator=2&over=1" opens a page at a moment, at rest; without it the page plays, unless its reader wants no motion.
const asked = new URLSearchParams(location.hash.slice(1));
// The second estimator is laid over the first, and a ship is followed, unless "over=0" or "follow=0" says otherwise.
const over = asked.has("over") ? Math.floor(Number(asked.get("over"))) - 1 : 1;
choose(Math.min(flights.length, Math.max(1, Math.floor(Number(asked.get("estimator"))) || 1)) - 1, over);
if (scene) follow(asked.has("follow") ? asked.get("follow") !== "0" : scene.hull === "ship");
if (asked.has("t")) go(Number(asked.get("t")) || 0);
play(!asked.has("t") && !window.matchMedia("(prefers-reduced-motion: reduce)").matches);
requestAnimationFrame(frame);

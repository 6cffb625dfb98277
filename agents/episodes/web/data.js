// Data of the page: unpacked arrays, what is shown now, and numbers as text.

const element = (id) => document.getElementById(id);
const style = getComputedStyle(document.documentElement); // live: it follows a change between light and dark
const colours = new Proxy({}, { get: (_, name) => style.getPropertyValue(`--${name}`).trim() });

/** Arrays, which JSON holds in base64. */
function unpack(_, packed) {
  if (!packed?.shape) return packed;
  const bytes = Uint8Array.from(atob(packed.float32), (c) => c.charCodeAt(0)), [rows, ...shape] = packed.shape;
  return { values: new Float32Array(bytes.buffer), rows, width: shape.reduce((a, b) => a * b, 1) };
}
const data = JSON.parse(element("episode").textContent, unpack), { scene, flights, focus, dt } = data;
const k = focus.length;
const row = (array, i) => array.values.subarray(i * array.width, (i + 1) * array.width);
const rows = (array, end = array.rows) => Array.from({ length: end }, (_, i) => row(array, i));
const lengthOf = (flight) => flight.charts[0].series[0].value.rows;
const duration = Math.max(...flights.map((f) => lengthOf(f) - 1)) * dt;

const state = { time: 0, first: 0, second: -1, playing: false, follow: false, speed: 1, dirty: true };
/** Marks of the first and of the second estimator; the second is dashed too, for whom colours look alike. */
const LOOKS = [
  { colour: "believed", member: "member", band: "band", fix: "measurement", dash: [], line: 3 },
  { colour: "second", member: "second", band: "band-second", fix: "second", dash: [6, 4], line: 1.8 },
];
/** The flights shown now, the first chosen on top. */
const shown = () => [state.first, state.second].flatMap((i, j) => (i < 0 ? [] : [{ flight: flights[i], look: LOOKS[j], index: i }]));
const overlaid = () => state.second >= 0;

/** A row between two steps, so that motion is smooth at any speed. */
function between(array, time) {
  const at = Math.min(time / dt, array.rows - 1), i = Math.floor(at), share = at - i;
  const a = row(array, i), b = row(array, Math.min(i + 1, array.rows - 1));
  return Array.from(a, (value, j) => value + share * (b[j] - value));
}
const stepAt = (flight, time) => Math.min(Math.floor(time / dt + 1e-6), lengthOf(flight) - 1);
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
/** Multiples of a round step within two ends. */
const levels = (low, high, step) => Array.from({ length: Math.max(0, Math.floor(high / step + 1e-6) - Math.ceil(low / step - 1e-6) + 1) }, (_, i) => (Math.ceil(low / step - 1e-6) + i) * step);
const number = (value, digits = 3) => (Number.isFinite(value) ? Number(value.toPrecision(digits)).toString().replace("-", "−") : "–");
const decimals = (value) => (Number.isFinite(value) ? value.toFixed(Math.abs(value) < 1 ? 3 : Math.abs(value) < 10 ? 2 : 1).replace(/^-(?=[0.]+$)/, "").replace("-", "−") : "–");
const clock = (time) => `${time.toFixed(1)} ${data.unit}`;
const scoreOf = (flight) => flight.scored ? `score ${flight.score.toFixed(3)} of 1` : `return ${number(flight.score, 4)}`;
/** Vertical position in the reader's terms: depth below the surface, altitude, or the coordinate itself. */
const HEIGHT = scene && (scene.hull === "aircraft"
  ? { word: "altitude", of: (down) => -down }
  : { word: "depth", of: (down) => down - (scene.surface ?? 0) });
/** False of a motion in a vertical plane that lies north. */
const WIDE = scene && scene.high[1] - scene.low[1] > 1e-3;
const placeInWords = ([north, east, down]) => [
  `${number(north)} m north`, ...(WIDE ? [`${number(east)} m east`] : []),
  ...(scene.space ? [`${HEIGHT.word} ${number(HEIGHT.of(down))} m`] : []),
].join(", ");
/** The error of the position. */
const errorInWords = (flight, i) => focus.map(({ name, unit }, j) => `${name.replace(" position", "")} ${decimals(row(flight.error, i)[j])}\u00a0${unit}`).join(", ");

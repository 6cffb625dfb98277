
// Charts over time, of one estimator or of two.

let charts = [];
/** A chart of the first estimator, and that of the same title of the second. */
function layCharts() {
  charts.forEach((chart) => chart.plot.destroy());
  const second = overlaid() ? flights[state.second] : null;
  charts = flights[state.first].charts.map((chart) => {
    const other = second?.charts.find(({ title }) => title === chart.title), box = document.createElement("div");
    box.innerHTML = '<h2><span></span><small></small><output></output></h2><div class="plot" role="img"></div>';
    const [title, room] = box.children, [name, labels, value] = title.children;
    const own = chart.series.map((each) => ({ ...each, label: other ? named(each, state.first) : each.label }));
    const lines = [...(other ? other.series.map((each) => ({ ...each, ...overlay(each) })) : []), ...own];
    name.textContent = chart.title;
    labels.append(...(other ? [...own, ...lines.slice(0, -own.length)] : own).filter(({ label }) => label).sort((a, b) => a.label.startsWith("true, ") - b.label.startsWith("true, ")).map(({ label, colour, dash }) => {
      const item = document.createElement("span");
      item.textContent = label; item.style.setProperty("--line", `var(--${colour})`); item.classList.toggle("dashed", Boolean(dash));
      return item;
    }));
    return { chart, other, lines, box, room, value };
  });
  element("charts").replaceChildren(...charts.map(({ box }) => box));
  charts.forEach(plot);
}
/** With two estimators a line goes by the name of its own. */
const named = ({ label, colour }, index) => (colour === "true_soft" ? `true, ${flights[index].estimator}` : flights[index].estimator);
/** Marks of a line of the second estimator. */
function overlay({ label, colour }) {
  const truth = colour === "true_soft", each = { label, colour };
  return { label: named(each, state.second), colour: truth ? "true" : ["true", "believed"].includes(colour) ? "second" : colour, width: 1.3, dash: [5, 3] };
}
/** Lowest and highest round level of an axis, and zero where its label has room between them. */
function ends(self, _, low, high) {
  const round = levels(low, high, round125((high - low) / 7.5)), first = round[0], last = round.at(-1);
  const apart = (v) => (Math.min(v - first, last - v) * (self.height - 26)) / (high - low) > 13;
  return [first, ...round.filter((v) => v === 0 && apart(v)), last];
}
function plot(each) {
  const { chart, other, lines, room } = each, length = Math.max(...lines.map(({ value }) => value.rows));
  const blank = new Array(length).fill(null), points = { show: false };
  const plain = (array) => (array ? Array.from({ length }, (_, i) => (Number.isFinite(array.values[i]) ? array.values[i] : null)) : blank);
  const axis = { stroke: () => colours.muted, grid: { stroke: () => colours.grid, width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
  const edge = { stroke: "transparent", points }, marks = LOOKS.map(({ fix }) => () => colours[fix]).reverse();
  const options = {
    width: Math.max(room.clientWidth, 50), height: Math.max(room.clientHeight, 50), legend: { show: false }, padding: [6, 22, 0, 0],
    cursor: { drag: { x: false, y: false }, y: false, points },
    scales: { x: { time: false, range: [0, duration] }, y: { range: (_, low, high) => [low - 0.06 * (high - low) - 1e-3, high + 0.06 * (high - low) + 1e-3] } },
    axes: [{ ...axis, size: 20, gap: 2, values: (_, at) => at.map((v) => (v ? `${v} ${data.unit}` : "")) }, { ...axis, size: 44, gap: 3, splits: ends, values: (_, at) => at.map((v) => number(v)) }],
    bands: [{ series: [1, 2], fill: () => colours.band }, { series: [3, 4], fill: () => colours["band-second"] }],
    series: [{}, edge, edge, edge, edge, { stroke: () => colours.zero, width: 1, points, auto: false },
      ...marks.map((mark) => ({ auto: false, width: 0, paths: () => null, points: { show: true, size: 3, fill: mark, stroke: mark } })),
      ...lines.map(({ colour, width = colour === "true_soft" ? 3.5 : 1.4, dash }) => ({ stroke: () => colours[colour], width, dash, points }))],
  };
  const [low, high] = chart.band ?? [], [low2, high2] = other?.band ?? [];
  each.plot = new uPlot(options, [blank.map((_, i) => i * dt), plain(high), plain(low), plain(high2), plain(low2), new Array(length).fill(0), plain(other?.measured), plain(chart.measured), ...lines.map(({ value }) => plain(value))], room);
  each.veil = document.createElement("div"); each.veil.className = "veil";
  each.plot.over.append(each.veil);
  const timeAt = (event) => {
    const box = each.plot.over.getBoundingClientRect();
    return Math.max(0, Math.min(duration, ((event.clientX - box.left) / box.width) * duration));
  };
  each.plot.over.addEventListener("pointerdown", (event) => {
    each.down = [event.clientX, event.clientY];
    if (event.pointerType === "touch") return; // it may begin to scroll the page: a tap is a click
    each.plot.over.setPointerCapture(event.pointerId); go(timeAt(event));
  });
  each.plot.over.addEventListener("click", (event) => go(timeAt(event)));
  each.plot.over.addEventListener("pointermove", (event) => {
    const time = timeAt(event);
    const [x, y] = each.down ?? [0, 0], along = Math.abs(event.clientX - x) > 8 + Math.abs(event.clientY - y);
    if (event.buttons && (event.pointerType !== "touch" || along)) go(time);
    tip(event, [`${chart.title} at ${clock(time)}`, ...valuesAt(each, time)]);
  });
  each.plot.over.addEventListener("pointerleave", () => tip());
}
/** Every line of a chart at a time, as text. */
function valuesAt({ chart, other, lines }, time) {
  const i = stepAt(flights[state.first], time), at = ({ values, rows }) => values[Math.min(Math.floor(time / dt + 1e-6), rows - 1)];
  const text = lines.map(({ label, value }) => `${label.replace(/,? ±2σ/, "") || flights[state.first].estimator}: ${number(at(value))}`);
  const [low, high] = (chart.band ?? []).map(({ values }) => values[i]);
  if (chart.band) text.push(`±2σ: ${number((high - low) / 2, 2)}`);
  for (const [each, index] of [[chart, state.first], [other, state.second]]) {
    if (each?.measured && Number.isFinite(at(each.measured))) text.push(`measured${other ? `, ${flights[index].estimator}` : ""}: ${number(at(each.measured))}`);
  }
  return text;
}
function drawCharts(time) {
  for (const each of charts) {
    const { chart, other, plot: drawn, veil, value, room } = each, i = stepAt(flights[state.first], time);
    veil.style.left = `${drawn.valToPos(Math.min(time, duration), "x")}px`;
    const v = chart.series.at(-1).value.values[i], half = chart.band ? (chart.band[1].values[i] - chart.band[0].values[i]) / 2 : NaN;
    const known = Number.isFinite(v) ? number(v) + (Number.isFinite(half) ? ` ± ${number(half, 2)}` : "") : "";
    const last = other?.series.at(-1).value, beside = other ? ` | ${number(last.values[stepAt(flights[state.second], time)])}` : "";
    value.textContent = chart.series.at(-1).label === "true" ? "not estimated" : known + beside;
    if (!state.playing) room.setAttribute("aria-label", `${chart.title} at ${clock(time)}: ${valuesAt(each, time).join(", ")}`);
  }
}
/** Values at the pointer; without an event there are none. */
function tip(event, lines = []) {
  const box = element("tip");
  box.hidden = !event;
  if (!event) return;
  box.replaceChildren(...lines.map((text) => { const item = document.createElement("div"); item.textContent = text; return item; }));
  box.style.left = `${Math.max(4, Math.min(event.clientX + 14, window.innerWidth - box.offsetWidth - 6))}px`;
  box.style.top = `${Math.max(4, Math.min(event.clientY + 14, window.innerHeight - box.offsetHeight - 6))}px`;
}

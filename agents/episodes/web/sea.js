
// Polar plot of the waves that the episode drew: north is up, and the radius is the frequency.

function drawSea() {
  const towards = row(data.waves, 0), hertz = row(data.waves, 1), rings = [0.1, 0.2, 0.3], most = Math.max(...hertz, 0.3);
  const radius = (f) => (44 * f) / most, svg = (name, marks) => `<${name} ${Object.entries(marks).map(([k, v]) => `${k}="${v}"`).join(" ")}/>`;
  const circles = rings.map((f) => svg("circle", { r: radius(f).toFixed(1), class: "ring" }));
  const dots = Array.from(towards, (a, i) =>
    svg("circle", { cx: (radius(hertz[i]) * Math.sin(a)).toFixed(1), cy: (-radius(hertz[i]) * Math.cos(a)).toFixed(1), r: 2, class: "wave" }));
  element("sea-plot").innerHTML = [svg("path", { d: "M0 -47V47M-47 0H47", class: "ring" }), ...circles, ...dots].join("");
  element("sea").hidden = false;
}
if (data.waves) drawSea();

/* -- strips: scrolled by whole pixels, so that a frame draws the newest rows alone ----------------------------------- */
const strips = [...document.querySelectorAll("figure")].map((figure, i) => {
  const canvas = figure.querySelector("canvas"), cursor = document.createElement("b"), times = document.createElement("p");
  const title = figure.querySelector("h2"), spans = figure.querySelectorAll("span");
  cursor.hidden = true;
  canvas.after(cursor);
  figure.append(times);
  times.append(...Array.from({length: 6}, () => document.createElement("span")));
  return {figure, canvas, cursor, times: times.children, title, c: canvas.getContext("2d", {alpha: true}), spans, lo: 0, hi: 1, k: 1, edge: 0, whole: true, i};
});
const TRACES = [  // value, colour, width, least and greatest since the row before
  [[r => r.hand && r.hand[0], "soft", 1], [r => r.xm[0], "master", 2], [r => r.xs[0], "slave", 2]],
  [[r => r.fm[0], "master", 1.5, r => num(r.fm_lo), r => num(r.fm_hi)], [r => r.fs[0], "slave", 1.5, r => num(r.fs_lo), r => num(r.fs_hi)]],
  [[r => r.kind === kind ? r.E : null, "ink", 1.5]],
  [[r => r.queue && r.queue[0], "master", 1.5], [r => r.queue && r.queue[1], "slave", 1.5]],
];
const ENERGY = {link: "Energy stored in the link", ports: "Net energy absorbed (negative: generated)"};
let kind = null, paused = null, pointed = null, told = 0;  // what the energy is of; s of the right edge (null: the newest row) and of the pointer; when the summary was written
const nice = v => { const p = 10 ** Math.floor(Math.log10(v)); return p * [1, 2, 5, 10].find(u => u * p >= v * .999); };
const edge = () => paused == null ? row ? row.t : 0 : paused;
function rowAt(t) {  // the index of the newest row up to t
  let low = 0, high = rows.length;
  while (low < high) { const middle = (low + high) >> 1; if (rows[middle].t <= t) low = middle + 1; else high = middle; }
  return low - 1;
}
const inView = () => rows.slice(Math.max(0, rowAt(edge() - SHOWN)), rowAt(edge()) + 1);
function look(t) {  // show the ten seconds up to t; null: the newest
  paused = t == null || !row ? null : clip(t, Math.min(rows[0].t + SHOWN, row.t), row.t);
  for (const one of strips) one.whole = dirty = true;
  rescale();
}
function tape() {
  const first = rows.length ? rows[0].t : 0, end = row ? row.t : 0;
  $("pause").setAttribute("aria-pressed", String(paused != null));
  $("back").disabled = paused == null;
  $("back").min = Math.min(first + SHOWN, edge());
  $("back").max = end;
  $("back").value = edge();
  $("when").textContent = paused == null ? "live" : end - paused < .05 ? "paused" : fixed(end - paused, 1) + " s ago";
  $("back").setAttribute("aria-valuetext", $("when").textContent);
}
const live = () => look(null);
$("pause").onclick = () => look(paused == null ? edge() : null);
$("back").oninput = event => look(+event.target.value);
for (const one of strips) {
  const seconds = event => (event.clientX - one.canvas.getBoundingClientRect().left) / one.canvas.clientWidth * SHOWN;
  let from = null;
  one.canvas.onpointerdown = event => { from = {x: event.clientX, t: edge()}; one.canvas.setPointerCapture(event.pointerId); };
  one.canvas.onpointermove = event => {
    if (from && Math.abs(event.clientX - from.x) > 3) look(from.t - (event.clientX - from.x) / one.canvas.clientWidth * SHOWN);
    pointed = clip(seconds(event), 0, SHOWN);
    captions();
  };
  one.canvas.onpointerup = one.canvas.onpointercancel = () => { from = null; };
  one.canvas.onpointerleave = () => { pointed = null; captions(); };
}
function narrow() {  // what went far away is back: as wide as it was again, once the strips show nothing else
  if (!hello || drag || view.span <= hello.span || !rows.length) return;
  let span = hello.span, wide = 0;
  for (const r of rows.slice(rowAt(row.t - SHOWN) + 1)) for (const x of [r.xm[0], r.xs[0], r.hand ? r.hand[0] : view.c]) wide = Math.max(wide, Math.abs(x - view.c));
  while (wide > .4 * span) span *= 1.25;
  if (span >= view.span) return;
  view.span = span;
  for (const one of strips) one.whole = true;
  dirty = true;
}
function extremes(list, i) {
  let low = Infinity, high = -Infinity;
  for (const r of list) for (const [f, , , a, b] of TRACES[i]) for (const of of [f, a, b]) {
    const v = of && of(r);
    if (v != null) { if (v > high) high = v; if (v < low) low = v; }
  }
  return [low, high];
}
function rescale() {
  narrow();
  tape();
  const list = inView(), least = [0, 1, .001, .001];
  kind = list.reduce((found, r) => r.kind || found, null);
  for (const one of strips) {
    const [low, high] = extremes(list, one.i), unit = nice(view.span / 8);
    const hi = one.i ? nice(Math.max(least[one.i], high, -low / 50)) : unit * Math.ceil((view.c + view.span / 2) / unit - 1e-9);
    const lo = !one.i ? unit * Math.floor((view.c - view.span / 2) / unit + 1e-9) : one.i < 3 && low < -.02 * hi ? -nice(-low) : 0;
    const k = one.i === 1 || (one.i === 2 && Math.max(hi, -lo) >= 1) ? 1 : 1e3;
    if (hi !== one.hi || lo !== one.lo || kind !== one.kind) Object.assign(one, {hi, lo, k, kind, whole: true});
    const number = v => fixed(v * k, Math.abs(v * k) < 10 && (v * k) % 1 ? 1 : 0);
    one.figure.querySelector(".hi").textContent = number(hi);
    one.figure.querySelector(".lo").textContent = number(lo);
    const name = ["Position", "Force", ENERGY[kind] || "Energy", "Queue of waves"][one.i];
    one.title.textContent = `${name}, ${[`m${metre()}`, newton().trim(), k === 1 ? "J" : "mJ", "ms"][one.i]}`;
    const ago = row ? row.t - edge() : 0;
    [...one.times].forEach((span, j) => { const t = SHOWN - 2 * j + ago; span.textContent = t < .05 ? "now" : fixed(-t, ago % 1 ? 1 : 0) + " s"; });
  }
  captions();
  if (performance.now() - told > 2e3) { told = performance.now(); summary(list); }
}
function captions() {  // the numbers of the row under the pointer, or else of the newest one shown
  const time = edge() - (pointed == null ? 0 : SHOWN - pointed), r = rows[rowAt(time + 1e-9)];
  for (const one of strips) {
    one.cursor.hidden = pointed == null;
    one.cursor.style.left = `calc(42px + (100% - 42px) * ${(pointed || 0) / SHOWN})`;
  }
  if (!r) return;
  const [pos, force, energy, queue] = strips.map(one => one.spans), when = pointed == null ? "" : `, ${fixed(row.t - time, 1)} s ago`;
  pos[0].textContent = `master ${fixed(r.xm[0] * 1e3, 1)} m${metre()}`;
  pos[1].textContent = `slave ${fixed(r.xs[0] * 1e3, 1)} m${metre()}`;
  pos[2].textContent = (hello && hello.wall != null ? `wall ${fixed(hello.wall * 1e3, 0)} m${metre()}` : "") + when;
  force[0].textContent = `master ${fixed(r.fm[0], 1)}${newton()}`;
  force[1].textContent = `slave ${fixed(r.fs[0], 1)}${newton()}${when}`;
  energy[0].textContent = (r.E == null ? (hello && hello.energy ? "\u2013" : "not kept in this scene") : Math.abs(r.E) < 1 ? fixed(r.E * 1e3, 1) + " mJ" : fixed(r.E, 1) + " J") + when;
  queue[0].textContent = r.queue ? "forward " + ms(r.queue[0]) : "no waves under this law";
  queue[1].textContent = r.queue ? "backward " + ms(r.queue[1]) + when : "";
}
function summary(list) {  // of what the strips show, for those who do not see them
  const sentences = strips.map(one => {
    const [low, high] = extremes(list, one.i);
    return low > high ? "" : `${one.title.textContent}: from ${fixed(low * one.k, 1)} to ${fixed(high * one.k, 1)}; ${paused == null ? "now" : "at the edge"} ${[...one.spans].map(span => span.textContent).filter(each => each).join(", ")}.`;
  });
  $("summary").textContent = `Ten seconds ${paused == null ? "up to now" : "up to " + $("when").textContent}. ${sentences.join(" ")}`;
}
function overview() {  // all axes as small strips, where there are more than can be drawn together
  if (few || !row) return;
  const list = inView();
  [...$("axes").children].forEach((button, i) => {
    const [output, canvas] = [button.querySelector("output"), button.querySelector("canvas")], c = canvas.getContext("2d");
    const w = canvas.width, h = canvas.height, traces = ["xm", "xs"].map(key => list.map(r => r.all[key][i])), span = hello.spans[i];
    const low = Math.min(-span / 8, ...traces.flat()), high = Math.max(span / 8, ...traces.flat()), y = v => h - 2 - (v - low) / (high - low) * (h - 4);
    output.textContent = `${fixed(row.all.xs[i] * 1e3, 0)} m${hello.units[i]}`;
    output.className = "num";
    c.clearRect(0, 0, w, h);
    c.fillStyle = C.line;
    c.fillRect(0, Math.round(y(0)), w, R);
    traces.forEach((values, of) => {
      c.strokeStyle = of ? C.slave : C.master;
      c.lineWidth = 1.5 * R;
      c.beginPath();
      values.forEach((v, n) => c.lineTo(w - 1 - (edge() - list[n].t) * w / SHOWN, y(v)));
      c.stroke();
    });
  });
}
function drawStrip(one) {
  const {canvas, c} = one, w = canvas.width, h = canvas.height, rate = w / SHOWN, end = edge();
  if (!rows.length) { c.clearRect(0, 0, w, h); return; }
  let by = Math.floor((end - one.edge) * rate);
  if (one.whole || by < 0 || by >= w) {
    one.edge = end;
    one.whole = false;
    by = w;
  } else if (by === 0) return;
  else {
    c.globalCompositeOperation = "copy";
    c.drawImage(canvas, -by, 0);
    c.globalCompositeOperation = "source-over";
    one.edge += by / rate;
  }
  // From a few pixels before the new ones on, so that the lines have no seam.
  const x0 = Math.max(0, w - by - 4), y = v => h - 1 - (v - one.lo) / (one.hi - one.lo) * (h - 2), x = t => w - 1 - (one.edge - t) * rate;
  c.clearRect(x0, 0, w, h);
  c.save();
  c.beginPath();
  c.rect(x0, 0, w, h);
  c.clip();
  c.fillStyle = C.line;
  if (one.lo < 0 && one.hi > 0) c.fillRect(x0, Math.round(y(0)), w, R);
  if (one.i === 0 && hello && hello.wall != null) {
    const at = Math.round(y(hello.wall));
    c.fillStyle = C.wall;
    c.globalAlpha = .13;
    c.fillRect(x0, 0, w, at);
    c.globalAlpha = 1;
    c.fillRect(x0, at, w, R);
  }
  const from = Math.max(0, rowAt(one.edge - (w - 1 - x0 + 3) / rate)), until = Math.min(rows.length, rowAt(one.edge) + 2);
  c.fillStyle = C.soft;
  for (let i = from; i < until; i++) if (rows[i].mark) c.fillRect(Math.round(x(rows[i].t)), 0, R, h);
  c.lineJoin = "round";
  for (const [f, colour, width, low, high] of TRACES[one.i]) {
    c.fillStyle = c.strokeStyle = C[colour];
    c.globalAlpha = .3;
    for (let i = from + 1; low && i < until; i++) {
      const a = low(rows[i]), b = high(rows[i]), left = x(rows[i - 1].t), right = x(rows[i].t);
      if (a != null && right - left < rate / 4) c.fillRect(left, y(b), right - left, y(a) - y(b));
    }
    c.globalAlpha = 1;
    c.lineWidth = width * R;
    c.beginPath();
    let on = false;
    for (let i = from; i < until; i++) {
      const v = f(rows[i]), gap = i && (rows[i].t - rows[i - 1].t > .25 || (one.i === 2 && rows[i].mark));
      if (v != null) c[on && !gap ? "lineTo" : "moveTo"](x(rows[i].t), y(v));
      on = v != null;
    }
    c.stroke();
  }
  c.restore();
}

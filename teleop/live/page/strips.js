/* -- strips: scrolled by whole pixels, so that a frame draws the newest rows alone ----------------------------------- */
const strips = [...document.querySelectorAll("figure")].map((figure, i) => {
  const canvas = figure.querySelector("canvas");
  return {figure, canvas, c: canvas.getContext("2d", {alpha: true}), spans: figure.querySelectorAll("span"), lo: 0, hi: 1, edge: 0, whole: true, i};
});
const TRACES = [
  [[r => r.hand && r.hand[0], "soft", 1], [r => r.xm[0], "master", 2], [r => r.xs[0], "slave", 2]],
  [[r => r.fm[0], "master", 1.5, r => num(r.fm_lo), r => num(r.fm_hi)], [r => r.fs[0], "slave", 1.5, r => num(r.fs_lo), r => num(r.fs_hi)]],
  [[r => r.E, "ink", 1.5]],
  [[r => r.queue && r.queue[0], "slave", 1.5], [r => r.queue && r.queue[1], "master", 1.5]],
];
const nice = v => { const p = 10 ** Math.floor(Math.log10(v)); return p * [1, 2, 5, 10].find(u => u * p >= v * .999); };
function narrow() {  // what went far away is back: as wide as it was again, once the strips show nothing else
  if (!hello || drag || view.span <= hello.span || !rows.length) return;
  let span = hello.span, wide = 0;
  const since = rows[rows.length - 1].t - SHOWN;
  for (const r of rows) if (r.t > since) for (const x of [r.xm[0], r.xs[0], r.hand ? r.hand[0] : view.c]) wide = Math.max(wide, Math.abs(x - view.c));
  while (wide > .4 * span) span *= 1.25;
  if (span >= view.span) return;
  view.span = span;
  for (const one of strips) one.whole = true;
  dirty = true;
}
function rescale() {
  narrow();
  const from = row ? row.t - SHOWN : 0, far = [0, 1, .001, .001], near = [0, 0, 0, 0];
  for (const r of rows) if (r.t > from) for (let i = 1; i < 4; i++) for (const [f, , , a, b] of TRACES[i]) for (const of of [f, a, b]) {
    const v = of && of(r);
    if (v != null) { if (v > far[i]) far[i] = v; if (v < near[i]) near[i] = v; }
  }
  for (const one of strips) {
    const i = one.i, hi = i ? nice(Math.max(far[i], -near[i] / 50)) : view.c + view.span / 2;
    const lo = !i ? view.c - view.span / 2 : i < 3 && near[i] < -.02 * hi ? -nice(-near[i]) : 0;
    if (hi !== one.hi || lo !== one.lo) { one.hi = hi; one.lo = lo; one.whole = true; }
    const k = i === 1 || (i === 2 && Math.max(hi, -lo) >= 1) ? 1 : 1e3, label = v => fixed(v * k, Math.abs(v * k) < 10 && (v * k) % 1 ? 1 : 0);
    one.figure.querySelector(".hi").textContent = label(hi);
    one.figure.querySelector(".lo").textContent = label(lo);
  }
  if (!row) return;
  const [pos, force, energy, queue] = strips.map(one => one.spans);
  pos[0].textContent = `master ${fixed(row.xm[0] * 1e3, 1)} m${metre()}`;
  pos[1].textContent = `slave ${fixed(row.xs[0] * 1e3, 1)} m${metre()}`;
  pos[2].textContent = hello && hello.wall != null ? `wall ${fixed(hello.wall * 1e3, 0)} m${metre()}` : "";
  force[0].textContent = `master ${fixed(row.fm[0], 1)}${newton()}`;
  force[1].textContent = `slave ${fixed(row.fs[0], 1)}${newton()}`;
  energy[0].textContent = row.E == null ? (hello && hello.energy ? "\u2013" : "not kept in this scene") : Math.abs(row.E) < 1 ? fixed(row.E * 1e3, 1) + " mJ" : fixed(row.E, 1) + " J";
  queue[0].textContent = row.queue ? "forward " + ms(row.queue[0]) : "";
  queue[1].textContent = row.queue ? "backward " + ms(row.queue[1]) : "";
}
function drawStrip(one) {
  const {canvas, c} = one, w = canvas.width, h = canvas.height, rate = w / SHOWN, last = rows[rows.length - 1];
  if (!last) { c.clearRect(0, 0, w, h); return; }
  let by = Math.floor((last.t - one.edge) * rate);
  if (one.whole || by < 0 || by >= w) {
    one.edge = last.t;
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
  let from = rows.length;
  while (from > 0 && x(rows[from - 1].t) > x0 - 3) from--;
  from = Math.max(0, from - 1);
  c.fillStyle = C.soft;
  for (let i = from; i < rows.length; i++) if (rows[i].mark) c.fillRect(Math.round(x(rows[i].t)), 0, R, h);
  c.lineJoin = "round";
  for (const [f, colour, width, low, high] of TRACES[one.i]) {
    c.fillStyle = c.strokeStyle = C[colour];
    c.globalAlpha = .3;
    for (let i = from + 1; low && i < rows.length; i++) {
      const a = low(rows[i]), b = high(rows[i]), left = x(rows[i - 1].t), right = x(rows[i].t);
      if (a != null && right - left < rate / 4) c.fillRect(left, y(b), right - left, y(a) - y(b));
    }
    c.globalAlpha = 1;
    c.lineWidth = width * R;
    c.beginPath();
    let on = false;
    for (let i = from; i < rows.length; i++) {
      const v = f(rows[i]), gap = i && rows[i].t - rows[i - 1].t > .25;
      if (v != null) c[on && !gap ? "lineTo" : "moveTo"](x(rows[i].t), y(v));
      on = v != null;
    }
    c.stroke();
  }
  c.restore();
}

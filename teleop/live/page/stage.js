/* -- the scene ---------------------------------------------------------------------------------------------------- */
function place() {  // where each end's coordinates lie on the canvas, px
  if (!hello || hello.axes === 1) {
    const scale = (W - 48) / view.span, ox = W / 2 - view.c * scale;
    return {scale, m: {ox, oy: H * .29, sy: 0}, s: {ox, oy: H * .73, sy: 0}};
  }
  const side = Math.min(W / 2 - 34, H - 60), scale = side / view.span, apart = Math.min(W / 4, side), ox = W / 2 - view.c * scale;
  return {scale, side, m: {ox: ox - apart, oy: H / 2, sy: -scale}, s: {ox: ox + apart, oy: H / 2, sy: -scale}};
}
const put = (p, at, x) => [at.ox + x[0] * p.scale, at.oy + (x.length > 1 ? x[1] * at.sy : 0)];
function text(what, x, y, colour, align = "left", bold = false) {
  g.font = (bold ? "600 " : "") + "14px system-ui, sans-serif";
  g.textAlign = align;
  g.fillStyle = colour;
  g.fillText(what, x, y);
}
// Labels are drawn last, each at the first place near its own that neither a body nor a label before it has.
const MOVES = [0, -20, 20, -40, 40, -60, 60].flatMap(dy => [0, -50, 50, -100, 100].map(dx => [dx, dy])).sort((a, b) => Math.hypot(...a) - Math.hypot(...b));
let bodies = [], labels = [], placed = {bodies, labels: []};  // boxes: left, top, right, bottom (px)
const apart = (a, b) => a[2] <= b[0] || b[2] <= a[0] || a[3] <= b[1] || b[3] <= a[1];
function label(what, x, y, colour, align = "left", bold = false) {
  if (what) labels.push({what, x, y, colour, align, bold});
}
function drawLabels() {
  const over = $("invite").getBoundingClientRect(), from = stage.getBoundingClientRect(), floor = H - (hello.axes > 1 ? 4 : 30);
  if (over.width) bodies.push([over.left - from.left, over.top - from.top, over.right - from.left, over.bottom - from.top]);
  placed = {bodies, labels: []};
  for (const {what, x, y, colour, align, bold} of labels) {
    g.font = (bold ? "600 " : "") + "14px system-ui, sans-serif";
    const w = g.measureText(what).width, left = x - ({left: 0, center: w / 2, right: w})[align];
    const boxes = MOVES.map(([dx, dy]) => [clip(left + dx, 4, W - w - 4), clip(y + dy, 16, floor)]).map(([a, b]) => [a, b - 13, a + w, b + 4]);
    const box = boxes.find(one => [...bodies, ...placed.labels].every(other => apart(one, other))) || boxes[0];
    placed.labels.push(box);
    text(what, box[0], box[3] - 4, colour, "left", bold);
  }
  bodies = [];
  labels = [];
}
function invite(p) {  // beside the wall, in the free space that the hand begins in
  const at = $("invite").style, flat = hello.axes > 1, wx = hello.wall == null ? W : p.s.ox + hello.wall * p.scale, right = wx > W / 2;
  if ($("invite").hidden) return;
  at.left = right || flat ? "14px" : wx + 12 + "px";
  at.width = flat ? "auto" : (right ? wx - 26 : W - wx - 26) + "px";
  at.top = H - $("invite").offsetHeight - (flat ? Math.max(2, Math.min(30, H / 2 - p.side / 2 - 28)) : 32) + "px";
  at.textAlign = right ? "right" : "left";
}
function line(colour, width, ...points) {
  g.strokeStyle = colour;
  g.lineWidth = width;
  g.beginPath();
  points.forEach(([x, y], i) => i ? g.lineTo(x, y) : g.moveTo(x, y));
  g.stroke();
}
function arrow(x, y, fx, fy, colour, name, lo, hi) {  // a force in N that acts at x, y (px)
  const per = .42 * (hello.axes > 1 ? W / 2 : W) / (hello.f_max || 20), size = Math.hypot(fx, fy);
  if (lo != null && hello.axes === 1 && hi - lo > .3) {
    g.globalAlpha = .28;
    line(colour, 12, [clip(x + lo * per, 4, W - 4), y], [clip(x + hi * per, 4, W - 4), y]);
    g.globalAlpha = 1;
  }
  if (size < .05) return;
  const length = Math.max(10, size * per), ux = fx / size, uy = -fy / size, ex = clip(x + ux * length, 8, W - 8), ey = y + uy * length;
  line(colour, 4, [x, y], [ex - 6 * ux, ey - 6 * uy]);
  g.beginPath();
  g.moveTo(ex, ey);
  g.lineTo(ex - 12 * ux - 7 * uy, ey - 12 * uy + 7 * ux);
  g.lineTo(ex - 12 * ux + 7 * uy, ey - 12 * uy - 7 * ux);
  g.fillStyle = colour;
  g.fill();
  bodies.push([Math.min(x, ex) - 5, Math.min(y, ey) - 6, Math.max(x, ex) + 5, Math.max(y, ey) + 6]);
  label(name, clip((x + ex) / 2, 30, W - 30), hello.axes > 1 ? Math.min(y, ey) - 14 : y - 11, colour, "center", true);
}
function spring(a, b, colour) {
  const dx = b[0] - a[0], dy = b[1] - a[1], d = Math.hypot(dx, dy), n = 12, points = [a];
  if (d < 3) return;
  const w = clip(9 - d / 60, 4, 8), nx = -dy / d * w, ny = dx / d * w;
  for (let i = 1; i < n; i++) points.push([a[0] + dx * i / n + (i % 2 ? nx : -nx), a[1] + dy * i / n + (i % 2 ? ny : -ny)]);
  line(colour, 2, ...points, b);
}
function curve(a, b, p) {  // the link's middle line from the master's a to the slave's b
  const q = 1 - p, flat = hello.axes > 1, cx = flat ? (a[0] + b[0]) / 2 : a[0], dx = flat ? (a[0] + b[0]) / 2 : b[0];
  const cy = flat ? a[1] : (a[1] + b[1]) / 2, dy = flat ? b[1] : (a[1] + b[1]) / 2;
  return [q * q * q * a[0] + 3 * q * q * p * cx + 3 * q * p * p * dx + p * p * p * b[0], q * q * q * a[1] + 3 * q * q * p * cy + 3 * q * p * p * dy + p * p * p * b[1]];
}
const SLOW = 8, LANE = 7, EVERY = .08;  // of the packets: slowness; px between the ways; s between two
function linkAndPackets(a, b, dt) {
  const off = way => hello.axes > 1 ? [0, way ? LANE : -LANE] : [way ? LANE : -LANE, 0], cut = lost || !row.age || row.age.includes(null);
  g.setLineDash(cut ? [3, 9] : []);
  for (const way of [0, 1]) {
    const [ox, oy] = off(way), points = [];
    for (let i = 0; i <= 16; i++) { const [x, y] = curve(a, b, i / 16); points.push([x + ox, y + oy]); }
    line(C.rail, 2, ...points);
  }
  g.setLineDash([]);
  if (still.matches) dots = [];
  else if (!cut) for (owed += dt; owed > EVERY; owed -= EVERY) for (const way of [0, 1]) {
    const T = clip((row.age[way] || 0) * SLOW, .12, 8), gone = Math.random() < (status.loss || 0);
    dots.push({way, p: 0, T: T * (1 + .2 * Math.random() * Math.min(1, (status.jitter || 0) / ((row.age[way] || 0) + 1e-4))), end: gone ? .25 + .5 * Math.random() : 2, fall: 0});
  }
  for (const d of dots) if (d.p < d.end) d.p += dt / d.T; else d.fall += dt;
  dots = dots.filter(d => d.p < 1 && d.fall < .8);
  for (const way of [0, 1]) {
    const [ox, oy] = off(way);
    g.fillStyle = way ? C.slave : C.master;
    g.beginPath();
    for (const d of dots) if (d.way === way && !d.fall) {
      const [x, y] = curve(a, b, way ? 1 - d.p : d.p);
      g.moveTo(x + ox + 3.5, y + oy);
      g.arc(x + ox, y + oy, 3.5, 0, 7);
    }
    g.fill();
    for (const d of dots) if (d.way === way && d.fall) {
      const [x, y] = curve(a, b, way ? 1 - d.p : d.p), k = d.fall / .8;
      g.globalAlpha = 1 - k;
      g.beginPath();
      g.arc(x + ox + (way ? 60 : -60) * k, y + oy + 50 * k * k, 3.5, 0, 7);
      g.fill();
      g.globalAlpha = 1;
    }
  }
  const flat = hello.axes > 1, x = flat ? W / 2 : 16, y = flat ? H - 10 : H * .52;
  if (lost) label(lost + " is lost", x, y, C.bad, flat ? "center" : "left", true);
  else if (!cut) {
    const one = (flat ? "\u2192 " : "\u2193 ") + ms(row.age[0]), other = (flat ? "\u2190 " : "\u2191 ") + ms(row.age[1]);
    label(one, flat ? x - 8 : x, y, C.master, flat ? "right" : "left");
    label(other, flat ? x + 8 : x + 78, y, C.slave);
  }
}
function wall(p, force) {
  if (hello.wall == null) return;
  const flat = hello.axes > 1, s = p.s, x = s.ox + hello.wall * p.scale, top = flat ? H / 2 - p.side / 2 : s.oy - 62, bottom = flat ? H / 2 + p.side / 2 : s.oy + 50;
  const right = flat ? s.ox + (view.c + view.span / 2) * p.scale : W, xs = row.xs || [hello.wall, 0], y = put(p, s, xs)[1], depth = Math.max(0, (xs[0] - hello.wall) * p.scale);
  const mx = p.m.ox + hello.wall * p.scale, load = clip(Math.abs(force || 0) / (.5 * (hello.f_max || 20)), 0, 1);
  g.beginPath();
  g.moveTo(right, top);
  g.lineTo(x, top);
  g.lineTo(x, y - 30);
  g.bezierCurveTo(x, y - 12, x + depth, y - 12, x + depth, y);
  g.bezierCurveTo(x + depth, y + 12, x, y + 12, x, y + 30);
  g.lineTo(x, bottom);
  g.lineTo(right, bottom);
  g.globalAlpha = .16;
  g.fillStyle = C.wall;
  g.fill();
  if (load > .01) {
    g.save();
    g.clip();
    const glow = g.createRadialGradient(x + depth, y, 2, x + depth, y, 30 + 90 * load);
    glow.addColorStop(0, C.wall);
    glow.addColorStop(1, C.wall + "00");
    g.globalAlpha = .25 + .75 * load;
    g.fillStyle = glow;
    g.fillRect(x - 4, y - 130, 140 + depth, 260);
    g.restore();
  }
  g.globalAlpha = 1;
  g.strokeStyle = C.wall;
  g.lineWidth = 3;
  g.beginPath();
  g.moveTo(x, top);
  g.lineTo(x, y - 30);
  g.bezierCurveTo(x, y - 12, x + depth, y - 12, x + depth, y);
  g.bezierCurveTo(x + depth, y + 12, x, y + 12, x, y + 30);
  g.lineTo(x, bottom);
  g.stroke();
  g.setLineDash([4, 5]);
  g.globalAlpha = .7;
  line(C.wall, 1.5, [mx, flat ? top : p.m.oy - 34], [mx, flat ? bottom : p.m.oy + 34]);
  g.globalAlpha = 1;
  g.setLineDash([]);
  label("wall", Math.min(right - 34, x + 12), bottom - 9, C.wall, "left", true);
}
function forces(m, s, fe, flat, dt) {
  shown.m += clip(dt * 6, 0, 1) * (Math.hypot(...row.fm) - shown.m);
  shown.s += clip(dt * 6, 0, 1) * (Math.hypot(...fe) - shown.s);
  const lo = num(row.fm_lo), hi = num(row.fm_hi);
  arrow(m[0], flat ? m[1] : m[1] - 42, -row.fm[0], flat ? -row.fm[1] : 0, C.master, fixed(shown.m, 1) + newton(), lo == null ? null : -hi, -lo);
  arrow(flat ? s[0] : s[0] - 50, s[1], -fe[0], flat ? -fe[1] : 0, C.slave, fixed(shown.s, 1) + newton());
}
function ruler(p) {
  const unit = [.001, .002, .005, .01, .02, .05, .1, .2, .5, 1, 2, 5].find(u => u * p.scale > 60) || 10;
  for (let k = Math.ceil((view.c - view.span / 2) / unit); k * unit <= view.c + view.span / 2; k++) {
    const x = p.s.ox + k * unit * p.scale;
    line(C.rail, 1, [x, H - 22], [x, H - 27]);
    text(fixed(k * unit * 1e3, 0) + (k === 0 ? ` m${metre()}` : ""), x, H - 7, C.soft, "center");
  }
}
function goal(p) {  // where the slave is to be brought, or how far the hand is to pull the master's spring
  const {at, width, of} = hello.target, rail = of === "hand" ? p.m : p.s, from = of === "hand" ? (row.xm || row.hand)[0] : 0;
  const [x, w] = [rail.ox + (from + at) * p.scale, Math.max(4, width * p.scale)], top = hello.axes > 1 ? H / 2 - p.side / 2 : rail.oy - 34;
  g.globalAlpha = .3;
  g.fillStyle = C.master;
  g.fillRect(x - w / 2, top, w, hello.axes > 1 ? p.side : 68);
  g.globalAlpha = 1;
  line(C.master, 2, [x - w / 2, top], [x - w / 2, top + (hello.axes > 1 ? p.side : 68)]);
  line(C.master, 2, [x + w / 2, top], [x + w / 2, top + (hello.axes > 1 ? p.side : 68)]);
}
function draw(dt) {
  g.setTransform(R, 0, 0, R, 0, 0);
  g.clearRect(0, 0, W, H);
  if (!hello || !row) return text(socket ? "waiting for the first tick" : "", W / 2, H / 2, C.soft, "center");
  const p = place(), flat = hello.axes > 1, m = put(p, p.m, row.xm || row.hand), s = row.xs && put(p, p.s, row.xs), fe = row.fe || row.fs, names = hello.words || ["master", "slave"];
  g.lineCap = g.lineJoin = "round";
  if (flat) for (const [at, name, colour] of [[p.m, names[0], C.master], [p.s, names[1], C.slave]]) {
    const x = at.ox + (view.c - view.span / 2) * p.scale, y = H / 2 - p.side / 2;
    g.strokeStyle = C.line;
    g.lineWidth = 1;
    g.strokeRect(x, y, p.side, p.side);
    label(name, x, y - 9, colour, "left", true);
    if (hello.axes > 2) {  // the third axis as a gauge beside its plane
      const gx = x + p.side + 9, z = v => H / 2 - clip(v / view.span, -.5, .5) * p.side, master = at === p.m;
      line(C.rail, 2, [gx, y], [gx, y + p.side]);
      if (master && row.hand) line(C.ink, 2, [gx - 6, z(row.hand[2])], [gx + 6, z(row.hand[2])]);
      g.fillStyle = colour;
      g.beginPath();
      g.arc(gx, z(((master ? row.xm : row.xs) || [0, 0, 0])[2]), 5, 0, 7);
      g.fill();
    }
  } else {
    line(C.rail, 2, [16, p.m.oy], [W - 16, p.m.oy]);
    line(C.rail, 2, [16, p.s.oy + 17], [W - 16, p.s.oy + 17]);
    label(names[0], 16, p.m.oy - 52, C.master, "left", true);
    label(names[1], 16, p.s.oy - 26, C.slave, "left", true);
    if (hello.ruler !== false) ruler(p);
  }
  const half = flat ? 11 : 26;
  bodies.push([m[0] - 11, m[1] - half, m[0] + 11, m[1] + half]);
  if (s) bodies.push([s[0] - (flat ? 10 : 48), s[1] - 17, s[0] + (flat ? 10 : 0), s[1] + 17]);
  wall(p, num(fe));
  if (hello.target) goal(p);
  if (row.age) linkAndPackets(flat ? m : [m[0], m[1] + 26], flat ? s : [s[0] - 28, s[1] - 17], dt);
  // The hand: where it wants the handle to be, and by how much the handle lags.
  if (row.hand) {
    const h = put(p, p.m, row.hand);
    spring(m, h, C.ink);
    g.strokeStyle = C.ink;
    g.lineWidth = 2;
    g.setLineDash([4, 4]);
    g.beginPath();
    g.arc(h[0], h[1], 17, 0, 7);
    g.stroke();
    g.setLineDash([]);
    bodies.push([h[0] - 19, h[1] - 19, h[0] + 19, h[1] + 19]);
    label("hand", clip(h[0], 22, W - 22), h[1] + 35, C.ink, "center");
  }
  g.fillStyle = C.master;
  g.beginPath();
  if (!row.xm) ;
  else if (flat) g.arc(m[0], m[1], 11, 0, 7);
  else g.roundRect(m[0] - 7, m[1] - 26, 14, 52, 7);
  g.fill();
  g.fillStyle = C.slave;
  g.beginPath();
  if (!s) ;
  else if (flat) g.roundRect(s[0] - 10, s[1] - 10, 20, 20, 4);
  else {
    g.roundRect(s[0] - 48, s[1] - 17, 38, 34, 6);
    g.rect(s[0] - 11, s[1] - 3, 8, 6);
    g.roundRect(s[0] - 8, s[1] - 8, 8, 16, 4);
  }
  g.fill();
  if (row.fm) forces(m, s, fe, flat, dt);
  invite(p);
  drawLabels();
  if ($("arm")) drawArm();
}

/* -- the robot from the side, by the outlines of its model ----------------------------------------------------------- */
let pose = null;  // of each outline: two rows of a rotation, and where it is, m; of the slave, and of its picture at the master's joints
function hull(points) {  // Andrew's monotone chain
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]), half = list => {
    const chain = [];
    for (const [x, y] of list) {
      while (chain.length > 1) {
        const [a, b] = chain.slice(-2);
        if ((b[0] - a[0]) * (y - a[1]) > (b[1] - a[1]) * (x - a[0])) break;
        chain.pop();
      }
      chain.push([x, y]);
    }
    return chain.slice(0, -1);
  };
  return sorted.length < 3 ? sorted : [...half(sorted), ...half(sorted.reverse())];
}
function drawArm() {
  const at = $("arm"), c = at.getContext("2d"), model = hello.arm;
  if (at.hidden === !!model) { at.hidden = !model; size(); }
  if (!model || !pose) return;
  const w = at.width / R, h = at.height / R, top = 28, k = Math.min(w, h - top) / model.span;  // the name is above it
  const put = ([x, y]) => [w / 2 + (x - model.middle[0]) * k, (h + top) / 2 - (y - model.middle[1]) * k];
  const outline = (points, radius, colour, alpha) => {
    const [first, ...others] = hull(points.map(put));
    for (const [wide, paint] of [[2, C.card], [0, colour]]) {
      c.globalAlpha = alpha;
      c.strokeStyle = c.fillStyle = paint;
      c.lineWidth = 2 * radius * k + wide;
      c.beginPath();
      c.moveTo(...first);
      (others.length ? others : [[first[0] + .01, first[1]]]).forEach(one => c.lineTo(...one));
      c.closePath();
      if (c.lineWidth) c.stroke();
      c.fill();
    }
    c.globalAlpha = 1;
  };
  c.setTransform(R, 0, 0, R, 0, 0);
  c.clearRect(0, 0, w, h);
  c.lineCap = c.lineJoin = "round";
  for (const {points, radius} of model.world) outline(points, radius, C.wall, .25);
  [...pose].reverse().forEach((at, i, all) => at.forEach(([a, b, d, e, f, n, x, y], j) => {
    const {points, radius} = model.shapes[j], slave = i === all.length - 1;
    outline(points.map(([u, v, q]) => [a * u + b * v + d * q + x, e * u + f * v + n * q + y]), radius, slave ? C.slave : C.master, slave ? 1 : .35);
  }));
  c.font = "600 14px system-ui, sans-serif";
  c.fillStyle = C.slave;
  c.fillText("slave, from the side", 12, 22);
}

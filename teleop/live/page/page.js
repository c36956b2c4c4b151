const SHOWN = 10, KEPT = 18e3;  // s of strips; rows
const bytes = n => { const k = n >= 1e9 ? 3 : n >= 1e6 ? 2 : 1; return +(n / 1e3 ** k).toPrecision(3) + " " + ["kB", "MB", "GB"][k - 1]; };
let rows = [], status = {};
const HELLO = "The demo runs again, and this page shows it.", ENDED = "Start it again with `teleop demo --page`, and this page comes back by itself.";
const finished = () => false, dropped = () => { drag = null; target = null; clutch = false; pressed(false); };
function colours() {
  palette();
  for (const one of strips) one.whole = true;
  dirty = true;
}
/* -- the server --------------------------------------------------------------------------------------------------- */
const heard = {
  hello(m) {
    const first = !hello || hello.scene !== m.scene;
    axes(m);
    lastTurn = performance.now();
    hello = m;
    view = {c: m.wall == null ? 0 : .08 * Math.sign(m.wall) * m.span, span: m.span};
    document.title = m.scene + " \u00b7 teleop";
    $("scene").textContent = m.scene;
    $("link").textContent = m.link || "";
    $("third").textContent = m.axes > 2 ? "Wheel, Page Up and Page Down move the third axis. " : "";
    if (m.wall == null) $("invite").firstChild.textContent = "Drag the handle";
    laws(m);
    sliders(m, first);
    for (const one of strips) one.whole = true;
    dirty = true;
  },
  rows(m) { take(m); },
  past(m) {
    rows = [];
    m.rows.forEach(take);
    scaled = 0;
    live();
    for (const one of strips) one.whole = true;
  },
  status(m) {
    status = m;
    lost = m.lost;
    $("delay").textContent = "delay " + ms(m.delay);
    $("jitter").textContent = "jitter " + ms(m.jitter);
    $("loss").textContent = "loss " + pc(m.loss);
    $("skipped").textContent = m.skipped >= 5e-4 ? `ticks skipped by this machine ${pc(m.skipped)}` : "";
    $("disk").textContent = m.free == null ? "" : `${m.idle ? "nothing is being written: nobody steers; " : ""}${bytes(m.written)} written, ${bytes(m.free)} left on the disk`;
    for (const [e, name] of [["m", "Master"], ["s", "Slave"]]) {
      const one = m[e] || {}, at = $("g" + e), off = m.clutch ? "Clutch open: both forces off" : m.switching ? "Switching..." : "";
      at.className = one.cause && !m.switching ? "safe" : "";
      at.textContent = off ? (e === "m" ? off : "") : one.gain == null ? "" : `${name}\u2019s force ${pc(one.gain)}${one.cause ? ": " + one.cause : ""}`;
    }
    $("policy").hidden = !m.policy;
    $("policy").setAttribute("aria-pressed", String(!!(m.policy && m.policy.on)));
    $("who").textContent = m.policy && m.policy.who ? m.policy.who[0].toUpperCase() + m.policy.who.slice(1) : "";
    connection();
    pressed(m.clutch || clutch);
    const scaled = $("k_scale");  // which another page may have set
    if (scaled && !scaled.busy && m.scale) { scaled.value = scale(scaled.one).of(m.scale); scaled.show(m.scale); }
    dirty = true;
  },
  said(m) { say(m.level, m.text); },
};
let axis = 0, few = true;  // of more than three axes one is shown and dragged, as if there were no other
const metre = () => hello && hello.units ? hello.units[axis] : "m", newton = () => metre() === "m" ? " N" : " N m";
function axes(m) {
  const at = $("axes");
  few = at.hidden = !m.names || m.names.length < 4;
  if (few) { axis = 0; return; }
  if (at.children.length !== m.names.length) {
    axis = 0;
    at.replaceChildren(...m.names.map((name, i) => {
      const button = Object.assign(document.createElement("button"), {type: "button", textContent: name, onclick: () => choose(i)});
      button.append(document.createElement("output"), document.createElement("canvas"));
      return button;
    }));
  }
  [...at.children].forEach((button, i) => button.setAttribute("aria-pressed", String(i === axis)));
  Object.assign(m, {axes: 1, wall: m.walls[axis], f_max: m.caps[axis], span: m.spans[axis]});
}
function along(r) {
  if (!r || few) return r;
  r.all = r.all || {...r};
  for (const key in r.all) if (Array.isArray(r.all[key]) && r.all[key].length === hello.names.length) r[key] = [r.all[key][axis]];
  return r;
}
const ofAll = to => row && row.all && to ? (row.all.hand || row.all.xm).map((x, i) => i === axis ? to[0] : x) : to;
function choose(i) {
  axis = i;
  axes(hello);
  rows.forEach(along);
  drag = null;
  if (target) target = [(row.all.hand || row.all.xm)[axis]];
  view = {c: 0, span: hello.span};
  for (const one of strips) one.whole = dirty = true;
}
function take(r) {
  along(r);
  const last = rows[rows.length - 1];
  if (last && r.t < last.t - 1) { rows = []; for (const one of strips) one.whole = true; }
  else if (last && r.t <= last.t) rows.pop();  // no tick since
  r.mark = rows.length > 0 && rows[rows.length - 1].part !== r.part;
  if (r.arm) pose = r.arm;
  rows.push(r);
  if (rows.length > KEPT) rows.splice(0, 600);
  row = r;
  const far = Math.max(...[r.xm[0], r.xs[0], r.hand ? r.hand[0] : 0].map(x => Math.abs(x - view.c)));
  if (far > .5 * view.span && far < 10) { while (far > .5 * view.span) view.span *= 1.25; for (const one of strips) one.whole = true; }
  dirty = true;
}

/* -- law, link, buttons ------------------------------------------------------------------------------------------- */
function laws(m) {
  const at = $("law"), all = m.laws.some(law => law.name === m.law) ? m.laws : [{name: m.law, says: ""}, ...m.laws];
  const names = all.map(law => law.name).join("\n");
  if (at.dataset.names !== names) {
    at.replaceChildren(...[...new Set(all.map(law => law.group))].map(group => {
      const several = Object.assign(document.createElement("optgroup"), {label: group || "On the running system"});
      several.append(...all.filter(law => law.group === group).map(law => new Option(law.name, law.name)));
      return several;
    }));
    at.dataset.names = names;
  }
  at.value = m.law;
  $("gains").textContent = m.gains;
  $("says").textContent = [all.find(law => law.name === m.law).says, ...m.notes.map(note => note + ".")].join(" ");
}
$("law").onchange = event => { if (!sent({type: "turn", law: event.target.value})) event.target.value = hello ? hello.law : ""; };

const scale = one => one.log
  ? {of: v => 1e3 * Math.log(v / one.low) / Math.log(one.high / one.low), at: p => one.low * (one.high / one.low) ** (p / 1e3)}
  : {of: v => 1e3 * (v - one.low) / (one.high - one.low), at: p => one.low + (one.high - one.low) * p / 1e3};
const tidy = {s: v => Math.round(v * 1e3) / 1e3, "": v => Math.round(v * 200) / 200};
function shownAs(one, v) {
  if (one.unit === "s") return ms(v);
  if (one.name === "loss") return pc(v);
  if (one.name === "scale") return `${+v.toPrecision(2)} times the hand\u2019s`;
  const k = v >= 1e3 ? 1e3 : 1;
  return `${+(v / k).toPrecision(2)} ${k > 1 ? "k" : ""}${one.unit}`;
}
function sliders(m, first) {
  if (first) $("sliders").replaceChildren();
  for (const one of m.sliders) {
    let input = $("k_" + one.name);
    if (!input) {
      const div = document.createElement("div"), label = document.createElement("label"), out = document.createElement("output");
      input = Object.assign(document.createElement("input"), {type: "range", id: "k_" + one.name, min: 0, max: 1000, step: 5});
      label.htmlFor = input.id;
      out.className = "num";
      label.append(one.label[0].toUpperCase() + one.label.slice(1), out);
      div.append(label, input);
      $("sliders").append(div);
      let timer = 0;
      const value = () => {
        const v = scale(input.one).at(+input.value);
        return clip(input.one.name === "loss" ? tidy[""](v) : (input.one.log ? x => +x.toPrecision(2) : tidy[input.one.unit])(v), input.one.low, input.one.high);
      };
      input.show = v => { out.textContent = shownAs(input.one, v); input.setAttribute("aria-valuetext", out.textContent); };
      input.oninput = () => { input.busy = true; input.show(value()); if (input.one.running) input.onchange(); };
      // A turn is a new session, so one is asked for when the slider rests, not at each step.
      // A scale is ramped where it is, so it follows the slider.
      input.onchange = () => {
        clearTimeout(timer);
        timer = setTimeout(() => {
          input.busy = false;
          sent(input.one.running ? {type: "scale", to: value()} : {type: "turn", [input.one.name]: value()});
        }, input.one.running ? 60 : 250);
      };
    }
    input.one = one;
    if (!input.busy) { input.value = scale(one).of(one.value); input.show(one.value); }
  }
}
let clutch = false;
function pressed(open) { $("clutch").setAttribute("aria-pressed", String(!!open)); }
function setClutch(open) {
  if (open === clutch) return;
  if (sent({type: "clutch", open}) || !open) { clutch = open; pressed(open); }
}
$("clutch").onpointerdown = event => { $("clutch").setPointerCapture(event.pointerId); setClutch(true); };
$("clutch").onpointerup = $("clutch").onpointercancel = $("clutch").onlostpointercapture = () => setClutch(false);
$("clutch").oncontextmenu = event => event.preventDefault();
$("policy").onclick = () => { letGo(); sent({type: "policy", takes: $("policy").getAttribute("aria-pressed") !== "true"}); };
$("again").onclick = again;
$("go").onclick = letGo;

/* -- keys ---------------------------------------------------------------------------------------------------------- */
function again() {
  letGo();
  sent({type: "again"});
}
onkeydown = event => {
  const at = event.target, free = at === stage || at === document.body;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape") return letGo();
  if (at.tagName === "SELECT") return;
  if (event.key === "c" || event.key === "C" || (at.id === "clutch" && (event.key === " " || event.key === "Enter"))) {
    event.preventDefault();
    if (!event.repeat) setClutch(true);
  } else if ((event.key === "r" || event.key === "R") && !event.repeat) again();
  else if ((event.key === "p" || event.key === "P") && !event.repeat) $("pause").click();
  else if ((event.key === "t" || event.key === "T") && !event.repeat && !$("policy").hidden) $("policy").click();
  else if (free) nudge(event);
};
onkeyup = event => { if ("cC Enter".includes(event.key)) setClutch(false); };
onblur = () => setClutch(false);
document.onvisibilitychange = () => { if (document.hidden) setClutch(false); };
ongamepadconnected = () => { pad = true; say("info", "A gamepad is connected: its stick moves the hand, its first button is the clutch."); };
let pad = false, padClutch = false;
function gamepad(dt) {
  for (const one of navigator.getGamepads()) {
    if (!one || !row) continue;
    const stick = [one.axes[0], -one.axes[1], -(one.axes[3] || 0)].map(v => Math.abs(v) < .15 ? 0 : v);
    const to = base().slice();
    if (to.some((_, i) => stick[i])) steer(to.map((x, i) => x + (stick[i] || 0) * dt * view.span));
    const down = one.buttons.length > 0 && one.buttons[0].pressed;
    if (down !== padClutch) setClutch(padClutch = down);
    return;
  }
}

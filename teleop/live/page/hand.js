/* -- the hand ----------------------------------------------------------------------------------------------------- */
let drag = null, target = null, due = false, lastSent = 0, lastMoved = 0, lastTurn = 0;
function base() {  // where the hand's reference is: what was asked for just now, or what the server shows
  return target || (row ? row.hand || row.xm : null);
}
const far = to => row && (!row.hand || Math.hypot(...to.map((x, i) => x - row.hand[i])) > .03 * view.span);
function steer(to) {
  const reach = .6 * view.span;
  target = to.map((x, i) => clip(x, (i ? 0 : view.c) - reach, (i ? 0 : view.c) + reach));
  due = true;
  lastMoved = performance.now();
  $("invite").hidden = true;
}
function flush(now) {  // at most 60 a second; at least 4 as long as this page holds the hand, so that a page that is gone is missed
  if (target && !drag && far(target) && now - Math.max(lastMoved, lastTurn) > 5e3) target = null;  // another page has the hand
  if (target && hello && ((due && now - lastSent > 16.6) || now - lastSent > 240)) {
    if (sent({type: "hand", to: ofAll(target)})) { due = false; lastSent = now; }
  }
}
function letGo() {
  drag = null;
  target = null;
  due = false;
  stage.classList.remove("drag");
  sent({type: "hand", to: null});
}
stage.onpointerdown = event => {
  if (drag || !row || event.button > 0) return;
  stage.setPointerCapture(event.pointerId);
  drag = {id: event.pointerId, x: event.clientX, y: event.clientY, from: base().slice(), scale: place().scale};
  stage.classList.add("drag");
};
stage.onpointermove = event => {
  if (!drag || event.pointerId !== drag.id) return;
  const by = [(event.clientX - drag.x) / drag.scale, (drag.y - event.clientY) / drag.scale];
  if (drag.moved || Math.hypot(event.clientX - drag.x, event.clientY - drag.y) > 2) {
    drag.moved = true;
    steer(drag.from.map((x, i) => i < 2 ? x + by[i] : x));
  }
};
stage.onpointerup = stage.onpointercancel = stage.onlostpointercapture = event => {
  if (!drag || event.pointerId !== drag.id) return;
  drag = null;
  stage.classList.remove("drag");
};
stage.ondblclick = letGo;  // a pointer that goes up alone leaves the reference where it is, so that a pressed wall stays felt
stage.addEventListener("wheel", event => {
  if (!hello || hello.axes < 3 || !base()) return;
  event.preventDefault();
  third(-event.deltaY * view.span / 3e3);
}, {passive: false});
function third(by) {
  const to = base().slice();
  to[2] += by;
  steer(to);
  if (drag) drag.from[2] = to[2];
}
const ARROWS = {ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowDown: [1, -1], ArrowUp: [1, 1], PageDown: [2, -1], PageUp: [2, 1]};
function nudge(event) {  // by an arrow key
  if (!ARROWS[event.key] || !base()) return;
  const [axis, way] = ARROWS[event.key], to = base().slice();
  if (axis >= to.length) return;
  event.preventDefault();
  to[axis] += way * view.span / (event.shiftKey ? 600 : 60);
  steer(to);
}

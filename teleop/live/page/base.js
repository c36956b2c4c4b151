"use strict";
const $ = id => document.getElementById(id), stage = $("stage"), g = stage.getContext("2d");
document.body.className = "";
let hello = null, row = null, lost = null, dirty = true;  // what is shown; who is missing
const dark = matchMedia("(prefers-color-scheme: dark)"), still = matchMedia("(prefers-reduced-motion: reduce)");
let C = {}, W = 0, H = 0, R = 1, view = {c: 0, span: .12}, dots = [], owed = 0, shown = {m: 0, s: 0}, frames = 0;
const num = v => Array.isArray(v) ? v[0] : v, clip = (v, lo, hi) => Math.min(hi, Math.max(lo, v));
const fixed = (v, n) => (Math.abs(v) < .5 * 10 ** -n ? 0 : v).toFixed(n).replace("-", "\u2212");
const ms = s => s == null ? "\u2013" : fixed(s * 1e3, s >= 5e-5 && s < .00995 ? 1 : 0) + " ms", pc = v => v == null ? "\u2013" : fixed(v * 100, v < .0995 && v >= 5e-4 ? 1 : 0) + " %";
function palette() {
  const css = getComputedStyle(document.documentElement);
  for (const name of ["card", "ink", "soft", "line", "rail", "master", "slave", "wall", "bad"]) C[name] = css.getPropertyValue("--" + name).trim();
  dirty = true;
}
function say(level, text) {
  const at = $("said");
  at.className = level;
  at.textContent = (level === "info" ? "" : "\u26A0 ") + text;
}
function fit() {  // each canvas to its place
  R = Math.min(2, devicePixelRatio || 1);
  for (const canvas of document.querySelectorAll("canvas")) {
    const box = canvas.getBoundingClientRect(), w = Math.max(1, Math.round(box.width * R)), h = Math.max(1, Math.round(box.height * R));
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    if (canvas === stage) { W = box.width; H = box.height; }
  }
  dirty = true;
}

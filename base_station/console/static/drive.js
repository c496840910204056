// Driving: arrows or W A S D, a gamepad, and the page's own pad. Only what is held drives; ten times a second the page
// says how, and the robot stands a quarter of a second after the last word.

import { stop } from "./emergency.js";
import { isTyping, order, toast } from "./orders.js";

const PERIOD_MS = 100;
const DEAD_ZONE = 0.15;
const STOP_BUTTON = 1; // B, or circle
const KEYS = {
  KeyW: [1, 0], ArrowUp: [1, 0], KeyS: [-1, 0], ArrowDown: [-1, 0],
  KeyA: [0, 1], ArrowLeft: [0, 1], KeyD: [0, -1], ArrowRight: [0, -1],
};
const PAD = { forward: [1, 0], backward: [-1, 0], left: [0, 1], right: [0, -1] };

const held = new Map(); // what is held, by key code or pad button: [forward, left]
let behaviour = "";
let moving = false;
let sending = null;
let hinted_s = -Infinity;
let stopPressed = false;

const clamp = (value) => Math.max(-1, Math.min(1, value));

export function setBehaviour(name) {
  if (name !== behaviour && name !== "teleop") letGo();
  behaviour = name;
  document.body.classList.toggle("teleop", name === "teleop");
}

function letGo() {
  held.clear();
  say();
}

function gamepads() {
  if (!document.hasFocus() || document.hidden) return [];
  return [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.connected);
}

// Whoever drives: the button stops under every behaviour.
function watchStopButton() {
  const pressed = gamepads().some((pad) => pad.buttons[STOP_BUTTON]?.pressed);
  if (pressed && !stopPressed && !document.body.classList.contains("replay")) stop();
  stopPressed = pressed;
}

function gamepad() {
  for (const pad of gamepads()) {
    const dead = (value) => (Math.abs(value) < DEAD_ZONE ? 0 : value);
    const forward = -dead(pad.axes[1] ?? 0) + (pad.buttons[12]?.pressed ? 1 : 0) - (pad.buttons[13]?.pressed ? 1 : 0);
    const left = -dead(pad.axes[0] ?? 0) + (pad.buttons[14]?.pressed ? 1 : 0) - (pad.buttons[15]?.pressed ? 1 : 0);
    if (forward || left) return [clamp(forward), clamp(left)];
  }
  return [0, 0];
}

function wanted() {
  let [forward, left] = gamepad();
  for (const [f, l] of held.values()) {
    forward += f;
    left += l;
  }
  return [clamp(forward), clamp(left)];
}

// One word at a time, in order: a late one must not overtake the one that says stand.
async function say() {
  const [forward, left] = behaviour === "teleop" ? wanted() : [0, 0];
  const drives = forward !== 0 || left !== 0;
  if (!drives && !moving) return;
  if (sending) {
    await sending;
    if (sending) return; // another has gone on from here
    return say();
  }
  moving = drives;
  sending = order({ kind: "drive", forward, left }, 1000);
  const error = await sending;
  sending = null;
  if (error) toast(error, "bad");
}

function hint() {
  if (performance.now() - hinted_s < 4000) return;
  hinted_s = performance.now();
  toast("To drive, choose the behaviour teleop.");
}

function press(name, direction) {
  if (behaviour !== "teleop") return hint();
  held.set(name, direction);
  say();
}

function leave(name) {
  if (held.delete(name)) say();
}

function onKey(event) {
  const direction = KEYS[event.code];
  if (!direction || isTyping(event.target) || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.closest?.(".q-select")?.querySelector('[aria-expanded="true"]')) return; // the keys choose in there
  if (behaviour !== "teleop") {
    if (event.code.startsWith("Key")) hint();
    return; // the arrows scroll the page
  }
  event.preventDefault();
  event.stopPropagation();
  if (!event.repeat) press(event.code, direction);
}

export function begin() {
  window.addEventListener("keydown", onKey, true);
  window.addEventListener("keyup", (event) => leave(event.code), true);
  for (const name of ["blur", "pagehide"]) window.addEventListener(name, letGo);
  document.addEventListener("visibilitychange", () => document.hidden && letGo());
  document.addEventListener("zservo-stop", letGo);
  window.addEventListener("gamepaddisconnected", letGo);
  window.addEventListener("gamepadconnected", (event) => toast(`Gamepad: ${event.gamepad.id.slice(0, 60)}`));
  document.addEventListener("pointerdown", (event) => {
    const button = event.target.closest?.("[data-drive]");
    if (!button) return;
    event.preventDefault();
    press(button.dataset.drive, PAD[button.dataset.drive]);
    button.classList.add("held");
    const end = () => {
      button.classList.remove("held");
      leave(button.dataset.drive);
    };
    for (const name of ["pointerup", "pointercancel"]) window.addEventListener(name, end, { once: true });
  });
  setInterval(() => {
    watchStopButton();
    say();
  }, PERIOD_MS);
}

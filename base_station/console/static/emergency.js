// The emergency stop: a bar of plain HTML outside of everything else, and the space bar.

import { UNREACHABLE, isTyping, order, toast } from "./orders.js";

const HINT = matchMedia("(hover: none)").matches ? "emergency stop" : "emergency stop · space bar";
const ELSEWHERE = "Press space in the station's terminal or the robot's own button, or cut its power.";
const TRIES = 3;
const WORTH_ANOTHER = /cannot be reached|does not answer|did not confirm/;
export const timings = []; // of the last stops: ms from the press to the robot's confirmation

export async function stop() {
  const pressed = performance.now();
  document.dispatchEvent(new Event("zservo-stop")); // whoever drives lets go
  bar().classList.add("asked");
  let error = "";
  for (let i = 0; i < TRIES; i++) {
    error = await order({ kind: "stop" });
    if (!WORTH_ANOTHER.test(error)) break;
  }
  timings.push(performance.now() - pressed);
  if (timings.length > 100) timings.shift();
  bar().classList.remove("asked");
  bar().classList.toggle("failed", error === UNREACHABLE);
  if (error === UNREACHABLE) say("NOT STOPPED", `${error} ${ELSEWHERE}`); // stands until the console is back
  else if (error) toast(error, "bad", 20000);
}

async function release() {
  const error = await order({ kind: "release" });
  toast(error || "The emergency stop is released.", error ? "bad" : "info");
}

const bar = () => document.getElementById("emergency");

// Tells how the robot stands; `status` as in every packet.
export function show(status) {
  const latched = !!status.latched;
  bar().classList.toggle("latched", latched);
  document.getElementById("release").hidden = !latched;
  bar().classList.remove("failed");
  say(latched ? "STOPPED" : "STOP", latched ? status.reason : HINT);
}

function say(title, hint) {
  document.getElementById("stop-title").textContent = title;
  document.getElementById("stop-hint").textContent = hint;
}

export function begin() {
  const button = document.getElementById("stop");
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    event.preventDefault();
    stop();
  });
  button.addEventListener("click", (event) => {
    if (event.detail === 0) stop(); // by Enter or a screen reader: no pointer went before
  });
  document.getElementById("release").addEventListener("click", release);
  window.addEventListener(
    "keydown",
    (event) => {
      if (event.code !== "Space" || isTyping(event.target) || document.body.classList.contains("replay")) return;
      event.preventDefault();
      event.stopImmediatePropagation();
      if (!event.repeat) stop();
    },
    true,
  );
  window.addEventListener(
    "keyup",
    (event) => {
      if (event.code === "Space" && !isTyping(event.target)) event.preventDefault(); // or a focused button is pressed
    },
    true,
  );
}

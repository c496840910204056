// The page's beginning: the emergency stop at once, the rest as soon as there is a place for the picture.

import * as choose from "./choose.js";
import * as drive from "./drive.js";
import * as emergency from "./emergency.js";
import * as picture from "./picture.js";
import { orderOrSay, toast } from "./orders.js";

const SCHEMES = ["auto", "light", "dark"];
const TITLES = { auto: "light or dark as the system", light: "light", dark: "dark" };

// Colour scheme: as the system has it, or as was chosen here.
function scheme(step) {
  let name = SCHEMES.includes(localStorage.scheme) ? localStorage.scheme : "auto";
  if (step) name = localStorage.scheme = SCHEMES[(SCHEMES.indexOf(name) + 1) % SCHEMES.length];
  window.Quasar.Dark.set(name === "auto" ? "auto" : name === "dark");
  const button = document.getElementById("scheme");
  if (button) Object.assign(button, { title: `Colours: ${TITLES[name]}`, textContent: { auto: "◐", light: "☀", dark: "☾" }[name] });
}

function whenThere(id, then) {
  const place = document.getElementById(id);
  if (place) then(place);
  else requestAnimationFrame(() => whenThere(id, then));
}

emergency.begin();
drive.begin();
whenThere("view", (host) => choose.begin(picture.begin(host)));
whenThere("scheme", (button) => {
  scheme(false);
  button.addEventListener("click", () => scheme(true));
});
whenThere("rate", (label) =>
  setInterval(() => {
    const text = picture.shown.head ? `${picture.rate_hz().toFixed(0)} pictures/s` : "";
    if (label.textContent !== text) label.textContent = text;
  }, 1000),
);
// A scene takes its size when the window's changes; but it is hidden at times, and its place changes by itself.
whenThere("map", (place) => new ResizeObserver(() => window.dispatchEvent(new Event("resize"))).observe(place));
window.zservo = { picture: picture.shown, stops: emergency.timings, order: orderOrSay, toast };

// Choosing the target: drag a box over it, or click on it.

import { orderOrSay, toast } from "./orders.js";
import { redraw, shown } from "./picture.js";

const CLICK_PX = 6; // on the screen: a shorter drag is a click
const CLICK_SHARE = 0.28; // of the frame's height: the box about a click
const LEAST_PX = 10; // of a side, in the frame

export function begin(overlay) {
  let from = null;
  const place = (event) => {
    const box = overlay.getBoundingClientRect();
    const scale = shown.head.width / box.width;
    const within = (value, most) => Math.max(0, Math.min(most, value * scale));
    return [within(event.clientX - box.left, shown.head.width), within(event.clientY - box.top, shown.head.height)];
  };
  const end = () => {
    from = shown.drag = null;
    redraw();
  };
  overlay.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || !shown.head || !shown.status.orders) return;
    event.preventDefault();
    document.activeElement?.blur?.();
    overlay.setPointerCapture(event.pointerId);
    from = { at: place(event), screen: [event.clientX, event.clientY] };
  });
  overlay.addEventListener("pointermove", (event) => {
    if (!from || !shown.head) return;
    shown.drag = between(from.at, place(event));
    redraw();
  });
  overlay.addEventListener("pointerup", (event) => {
    if (!from || !shown.head) return end();
    const far = Math.hypot(event.clientX - from.screen[0], event.clientY - from.screen[1]);
    const box = far < CLICK_PX ? around(from.at) : between(from.at, place(event));
    end();
    choose(box);
  });
  overlay.addEventListener("pointercancel", end);
  window.addEventListener("keydown", (event) => event.key === "Escape" && from && end());
}

async function choose(box) {
  if (box.width < LEAST_PX || box.height < LEAST_PX) return toast("This box is too small: drag a larger one.");
  const error = await orderOrSay({ kind: "learn", box: [box.x, box.y, box.width, box.height] });
  if (!error) toast(`Target: ${box.width.toFixed(0)}×${box.height.toFixed(0)} px`);
}

function between([x0, y0], [x1, y1]) {
  return { x: Math.min(x0, x1), y: Math.min(y0, y1), width: Math.abs(x1 - x0), height: Math.abs(y1 - y0) };
}

function around([x, y]) {
  const side = CLICK_SHARE * shown.head.height;
  const within = (middle, most) => Math.max(0, Math.min(most - side, middle - side / 2));
  return { x: within(x, shown.head.width), y: within(y, shown.head.height), width: side, height: side };
}

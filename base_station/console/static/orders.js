// Orders to the station over plain HTTP, and short messages to the person at the page.

export const UNREACHABLE = "The console cannot be reached.";
const MOST_TOASTS = 2;
const toasts = () => document.getElementById("toasts");

export function toast(text, kind = "info", stay_ms = 5000) {
  const box = toasts();
  if (!box || !text) return;
  for (const old of box.children) if (old.textContent === text) old.remove();
  const note = document.createElement("div");
  note.className = `toast ${kind}`;
  note.textContent = text;
  box.append(note);
  while (box.children.length > MOST_TOASTS) box.firstChild.remove();
  setTimeout(() => note.remove(), stay_ms);
}

// Resolves to what went wrong, in words; empty when all is well.
export async function order(fields, patience_ms = 4000) {
  try {
    const answer = await fetch("/order", {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify(fields),
      keepalive: true,
      signal: AbortSignal.timeout(patience_ms),
    });
    return (await answer.json()).error ?? "";
  } catch {
    return UNREACHABLE;
  }
}

export async function orderOrSay(fields) {
  const error = await order(fields);
  if (error) toast(error, "bad");
  return error;
}

// Whether keys now write text: then they neither stop nor drive. A chosen select holds a read-only input.
export function isTyping(target) {
  if (!(target instanceof HTMLElement)) return false;
  if (target.isContentEditable || target.tagName === "TEXTAREA") return true;
  return target.tagName === "INPUT" && !target.readOnly && !["button", "checkbox", "radio", "range"].includes(target.type);
}

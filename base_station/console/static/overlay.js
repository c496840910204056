// The picture, and what is drawn over it: the target's box and its rows, bearing, zoom, what the tracker follows, a dragged box.

const COLOURS = { TRACKING: "#3ddc84", LOST: "#ff6b5e", INITIALIZING: "#ffc247", shadow: "#58b7ff", drag: "#ffffff" };

export function draw(context, shown, image, ratio) {
  const head = shown.head;
  if (!head) return say(context, ratio, "no picture", shown.status.link ?? "");
  const scale = context.canvas.width / head.width;
  context.lineJoin = "round";
  picture(context, image, head, scale);
  features(context, head, scale, ratio);
  if (head.shadow) outline(context, head.shadow, head, scale, ratio, COLOURS.shadow, 0);
  outline(context, head.seen, head, scale, ratio, COLOURS[head.seen.state], head.bands);
  bearing(context, head, scale, ratio);
  words(context, head, ratio);
  if (shown.drag) {
    const { x, y, width: w, height: h } = shown.drag;
    context.strokeStyle = COLOURS.drag;
    context.lineWidth = 2 * ratio;
    context.setLineDash([6 * ratio, 4 * ratio]);
    context.strokeRect(x * scale, y * scale, w * scale, h * scale);
    context.setLineDash([]);
  }
}

function say(context, ratio, title, text) {
  const { width, height } = context.canvas;
  context.fillStyle = "#101418";
  context.fillRect(0, 0, width, height);
  context.textAlign = "center";
  context.fillStyle = "#c5ccd3";
  context.font = `600 ${18 * ratio}px system-ui, sans-serif`;
  context.fillText(title, width / 2, height / 2 - 6 * ratio);
  context.font = `${13 * ratio}px system-ui, sans-serif`;
  context.fillStyle = "#8b949e";
  lines(context, text, width - 24 * ratio).forEach((line, i) => {
    context.fillText(line, width / 2, height / 2 + (16 + 18 * i) * ratio, width - 24 * ratio);
  });
  context.textAlign = "left";
}

function lines(context, text, width) {
  const found = [];
  for (const word of text.split(" ")) {
    const longer = found.length ? `${found.at(-1)} ${word}` : word;
    if (found.length && context.measureText(longer).width <= width) found[found.length - 1] = longer;
    else found.push(word);
  }
  return found;
}

// All of it, or the rows that the robot sends.
function picture(context, image, head, scale) {
  if (head.rows < head.height) {
    context.fillStyle = "#0f0f0f";
    context.fillRect(0, 0, context.canvas.width, context.canvas.height);
  }
  context.drawImage(image, 0, head.first_row * scale, head.width * scale, head.rows * scale);
}

function features(context, head, scale, ratio) {
  context.fillStyle = "rgba(255, 214, 10, 0.85)";
  const side = 3 * ratio;
  for (let i = 0; i < head.points.length; i += 2) {
    context.fillRect(head.points[i] * scale - side / 2, head.points[i + 1] * scale - side / 2, side, side);
  }
}

function outline(context, seen, head, scale, ratio, colour, bands) {
  if (!seen.box) return;
  const [x, y, w, h] = seen.box.map((side) => side * scale);
  context.strokeStyle = "rgba(0, 0, 0, 0.55)";
  context.lineWidth = 4 * ratio;
  context.strokeRect(x, y, w, h);
  context.strokeStyle = colour;
  context.lineWidth = 2 * ratio;
  context.strokeRect(x, y, w, h);
  if (bands < 2) return;
  context.globalAlpha = 0.45;
  context.lineWidth = ratio;
  context.beginPath();
  for (let i = 1; i < bands; i++) {
    context.moveTo(x, y + (h * i) / bands);
    context.lineTo(x + w, y + (h * i) / bands);
  }
  context.stroke();
  context.globalAlpha = 1;
}

// A mark at the top for straight ahead, and a line down at the target's bearing.
function bearing(context, head, scale, ratio) {
  const ahead = head.center_px * scale;
  context.fillStyle = "rgba(255, 255, 255, 0.7)";
  context.beginPath();
  context.moveTo(ahead - 5 * ratio, 0);
  context.lineTo(ahead + 5 * ratio, 0);
  context.lineTo(ahead, 8 * ratio);
  context.fill();
  if (head.seen.bearing_rad === null || Math.abs(head.seen.bearing_rad) > 1.4) return;
  const x = (head.center_px - head.focal_px * Math.tan(head.seen.bearing_rad)) * scale;
  context.strokeStyle = COLOURS[head.seen.state];
  context.globalAlpha = 0.6;
  context.lineWidth = 1.5 * ratio;
  context.setLineDash([3 * ratio, 5 * ratio]);
  context.beginPath();
  context.moveTo(x, 0);
  context.lineTo(x, context.canvas.height);
  context.stroke();
  context.setLineDash([]);
  context.globalAlpha = 1;
}

function words(context, head, ratio) {
  const seen = head.seen;
  const parts = [seen.state.toLowerCase()];
  if (seen.bearing_rad !== null) parts.push(`${signed((seen.bearing_rad * 180) / Math.PI, 1)}°`);
  if (seen.zoom !== null) parts.push(`×${seen.zoom.toFixed(3)}`);
  if (seen.range_m !== null) parts.push(`${seen.range_m.toFixed(2)} m`);
  label(context, parts.join("  "), 8 * ratio, ratio, COLOURS[seen.state]);
  if (seen.reason) label(context, seen.reason, 32 * ratio, ratio, "#e6e9ec");
}

export const signed = (value, digits) => (value < 0 ? "−" : "+") + Math.abs(value).toFixed(digits);

function label(context, text, y, ratio, colour) {
  context.font = `600 ${13 * ratio}px system-ui, sans-serif`;
  const width = Math.min(context.measureText(text).width, context.canvas.width - 28 * ratio);
  context.fillStyle = "rgba(10, 14, 18, 0.72)";
  context.fillRect(8 * ratio, y, width + 14 * ratio, 21 * ratio);
  context.fillStyle = colour;
  context.fillText(text, 15 * ratio, y + 15 * ratio, width);
}

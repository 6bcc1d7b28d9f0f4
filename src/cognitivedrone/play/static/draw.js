// The map, the sticks and the traces, on canvases.
const COLORS = { red: "#ef5350", green: "#43be67", blue: "#5484ff" };
const INK = "#f0f2f8", SOFT = "#a0a7ba", GRID = "#282e40", GROUND = "#1a1e2c", OBSTACLE = "#948470";

function clear(canvas) {
  const pen = canvas.getContext("2d");
  pen.fillStyle = GROUND;
  pen.fillRect(0, 0, canvas.width, canvas.height);
  return pen;
}

// World metres (x forward, y left) to pixels: the stage's x axis to the right.
export function drawMap(canvas, scene, path, live) {
  const pen = clear(canvas), { gates, obstacles = [], origin = [0, 0], yaw = 0 } = scene;
  const local = ([x, y]) => {
    const [dx, dy] = [x - origin[0], y - origin[1]], [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    return [c * dx + s * dy, -s * dx + c * dy];
  };
  const known = [[-2, -1.5], [0, 1.5], ...gates.flatMap((gate) => gate.ends.map(local)), ...path.map(local)];
  const [low, high] = [0, 1].map((axis) => known.map((each) => each[axis])).map((each) => [Math.min(...each) - 1, Math.max(...each) + 1]);
  const scale = Math.min(canvas.width / (low[1] - low[0]), canvas.height / (high[1] - high[0]));
  const middle = [(low[0] + low[1]) / 2, (high[0] + high[1]) / 2];
  const page = ([x, y]) => [canvas.width / 2 + (x - middle[0]) * scale, canvas.height / 2 - (y - middle[1]) * scale];
  pen.strokeStyle = GRID;
  pen.lineWidth = 1;
  for (let meter = -40; meter <= 40; meter += 2) {
    const [x, y] = page([meter, meter]);
    pen.beginPath(); pen.moveTo(x, 0); pen.lineTo(x, canvas.height); pen.moveTo(0, y); pen.lineTo(canvas.width, y); pen.stroke();
  }
  pen.fillStyle = OBSTACLE;
  obstacles.forEach((outline) => {
    pen.beginPath();
    outline.forEach((corner, i) => pen[i ? "lineTo" : "moveTo"](...page(local(corner))));
    pen.fill();
  });
  pen.font = "14px system-ui, sans-serif";
  gates.forEach((gate) => {
    const [x, y] = page(local(gate.at));
    pen.strokeStyle = COLORS[gate.color];
    pen.lineCap = "round";
    [[gate.way, 2], [gate.ends, 6]].filter(([ends]) => ends?.length).forEach(([ends, width]) => {  // its way, if it moves
      const [a, b] = ends.map((end) => page(local(end)));
      pen.lineWidth = width;
      pen.beginPath(); pen.moveTo(...a); pen.lineTo(...b); pen.stroke();
    });
    pen.fillStyle = SOFT;
    pen.textAlign = "center";
    const far = x > 0.8 * canvas.width;
    pen.textAlign = far ? "right" : "left";
    pen.fillText(`${gate.number} ${gate.name}`, x + (far ? -10 : 10), y + 5);
  });
  pen.textAlign = "left";
  if (!live.position) return;
  pen.strokeStyle = "#facc15";
  pen.lineWidth = 2;
  pen.beginPath();
  path.forEach((each, i) => pen[i ? "lineTo" : "moveTo"](...page(local(each))));
  pen.stroke();
  const [x, y] = page(local(live.position)), heading = (live.yaw ?? 0) - yaw;
  if (live.action) {  // where it is headed
    const angle = heading + Math.atan2(live.action[1], live.action[0]), speed = Math.hypot(live.action[0], live.action[1]);
    pen.strokeStyle = "#34d399";
    pen.beginPath(); pen.moveTo(x, y); pen.lineTo(x + Math.cos(angle) * speed * scale, y - Math.sin(angle) * speed * scale); pen.stroke();
  }
  pen.save();
  pen.translate(x, y);
  pen.rotate(-heading);
  pen.fillStyle = INK;
  pen.beginPath(); pen.moveTo(12, 0); pen.lineTo(-9, 8); pen.lineTo(-4, 0); pen.lineTo(-9, -8); pen.fill();
  pen.restore();
}

// Mode 2 of a remote control: left stick climbs and turns, right stick moves.
export function drawSticks(canvas, [vx, vy, vz, turn]) {
  const pen = clear(canvas), half = 55, limits = { v: 3, turn: 1 };
  const knobs = [[80, -turn / limits.turn, vz / limits.v, "climb, turn"], [240, -vy / limits.v, vx / limits.v, "forward, sideways"]];
  pen.font = "12px system-ui, sans-serif";
  for (const [x, across, up, name] of knobs) {
    const y = 68, [kx, ky] = [across, -up].map((each) => Math.max(-1, Math.min(1, each)) * (half - 8));
    pen.strokeStyle = "#343a4e";
    pen.lineWidth = 2;
    pen.strokeRect(x - half, y - half, 2 * half, 2 * half);
    pen.beginPath(); pen.moveTo(x - half, y); pen.lineTo(x + half, y); pen.moveTo(x, y - half); pen.lineTo(x, y + half); pen.stroke();
    pen.strokeStyle = "#34d399";
    pen.lineWidth = 4;
    pen.beginPath(); pen.moveTo(x, y); pen.lineTo(x + kx, y + ky); pen.stroke();
    pen.fillStyle = INK;
    pen.beginPath(); pen.arc(x + kx, y + ky, 8, 0, 7); pen.fill();
    pen.fillStyle = SOFT;
    pen.textAlign = "center";
    pen.fillText(name, x, 142);
  }
}

export function drawTraces(canvas, traces) {
  const pen = clear(canvas);
  pen.font = "12px system-ui, sans-serif";
  pen.textAlign = "left";
  [["speed", "m/s", 4, "#60a5fa"], ["policy", "ms", 100, "#fb923c"]].forEach(([key, unit, most, color], row) => {
    const top = 22 + 75 * row, height = 48;
    const largest = Math.max(most / 4, ...traces.map((each) => each[key]));
    pen.strokeStyle = color;
    pen.lineWidth = 1.5;
    pen.beginPath();
    traces.forEach((each, i) => pen[i ? "lineTo" : "moveTo"](8 + (i * (canvas.width - 16)) / 200, top + height * (1 - each[key] / largest)));
    pen.stroke();
    pen.fillStyle = SOFT;
    pen.fillText(`${key}: ${traces.length ? traces.at(-1)[key].toFixed(1) : "-"} ${unit} (top of the scale ${largest.toFixed(0)})`, 8, top - 8);
  });
}

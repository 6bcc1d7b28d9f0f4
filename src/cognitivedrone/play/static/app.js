// The page of a flight: draws what the websocket brings, and sends what the person does. No library, no build step.
import { replay } from "./replay.js";
import { drawMap, drawSticks, drawTraces } from "./draw.js";

const $ = (id) => document.getElementById(id);
const make = (tag, attributes = {}, ...children) => {
  const made = Object.assign(document.createElement(tag), attributes);
  made.append(...children);
  return made;
};
$("refused").remove();
const state = { session: {}, scene: { gates: [] }, live: {}, path: [], traces: [], frame: null, socket: null };

// --- the connection: everything is sent again after a reload or a break
function connect() {
  const at = new URL("live", location.href);
  at.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  at.search = location.search;
  const socket = new WebSocket(at);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { phase("connected"); };
  socket.onmessage = ({ data }) => (typeof data === "string" ? text(JSON.parse(data)) : picture(data));
  socket.onclose = ({ reason }) => { phase(reason || "not connected"); setTimeout(connect, 1000); };
  state.socket = socket;
}

function send(command, values = {}) {
  if (state.socket?.readyState === WebSocket.OPEN) state.socket.send(JSON.stringify({ do: command, ...values }));
}

function text(message) {
  if (message.channel === "session") session(message);
  else if (message.channel === "state") live(message);
  else if (message.channel === "scene") scene(message);
  else if (message.channel === "replay") { phase("recorded"); replay(message, send); }
  else if (message.channel === "error") notice(message.text, true);
  else if (message.channel === "chase") $("chase").parentElement.hidden = true;
}

async function picture(data) {
  const kind = String.fromCharCode(new Uint8Array(data, 0, 1)[0]);
  const image = await createImageBitmap(new Blob([new Uint8Array(data, 1)], { type: "image/jpeg" }));
  const canvas = $(kind === "c" ? "camera" : "chase");
  if (kind === "c") { state.frame?.close(); state.frame = image; drawCamera(); crops(); } else {
    if (canvas.width !== image.width) { canvas.width = image.width; canvas.height = image.height; }
    canvas.getContext("2d").drawImage(image, 0, 0);
    image.close();
  }
}

function drawCamera() {
  const canvas = $("camera"), pen = canvas.getContext("2d"), scale = canvas.width / state.frame.width;
  pen.imageSmoothingQuality = "high";
  pen.drawImage(state.frame, 0, 0, canvas.width, canvas.height);
  pen.font = "600 15px system-ui, sans-serif";
  (state.live.seen ?? []).forEach((panel, index) => {
    if (!panel.box) return;
    const [u, v, height] = panel.box.map((each) => each * scale), half = height / 2 + 3;
    pen.strokeStyle = chosen(state.live.seen) === index ? "#4ade80" : "rgb(255 255 255 / .55)";
    pen.lineWidth = 2;
    pen.strokeRect(u - half, v - half, 2 * half, 2 * half);
    pen.fillStyle = pen.strokeStyle;
    pen.fillText(String(index + 1), u - half, v - half - 4);
  });
}

function chosen(seen) {
  const best = (seen ?? []).reduce((best, panel, i) => ((panel.right ?? 0) > (best.right ?? 0) ? { right: panel.right, i } : best), { right: 0.34, i: null });
  return best.i;
}

// --- what the drone thinks
function panels(seen) {
  const place = $("panels");
  while (place.children.length > seen.length) place.lastChild.remove();
  seen.forEach((panel, index) => {
    let card = place.children[index];
    if (!card) {
      card = make("div", { className: "panel" }, make("canvas", { width: 96, height: 96 }),
        make("div", { className: "name" }, make("span"), make("span")), make("div", { className: "bars" }),
        make("div", { className: "bar right" }, make("i"), make("span")));
      place.append(card);
    }
    card.classList.toggle("chosen", chosen(seen) === index);
    const [dot, name] = card.children[1].children;
    if (dot.className !== `dot ${panel.color}`) card.firstChild.getContext("2d").clearRect(0, 0, 96, 96);  // another gate's crop
    dot.className = `dot ${panel.color}`;
    const [likeliest] = panel.readings;
    name.textContent = `${index + 1} ${likeliest?.[1] >= 0.2 ? likeliest[0] : panel.shown}`;
    card.children[2].replaceChildren(...panel.readings.filter(([, share]) => share >= 0.02).map(([what, share]) => bar(what, share)));
    const right = card.children[3];
    right.hidden = panel.right === null;
    right.firstChild.style.width = `${100 * (panel.right ?? 0)}%`;
    right.lastChild.textContent = `right gate ${Math.round(100 * (panel.right ?? 0))} %`;
  });
}

function bar(what, share) {
  const inner = make("i");
  inner.style.width = `${100 * share}%`;
  return make("div", { className: "bar", title: `${what} ${Math.round(100 * share)} %` }, inner, make("span", { textContent: `${what} ${Math.round(100 * share)} %` }));
}

function crops() {
  (state.live.seen ?? []).forEach((panel, index) => {
    const canvas = $("panels").children[index]?.firstChild;
    if (!canvas || !state.frame || !panel.box) return;
    const [u, v, height] = panel.box, side = Math.max(10, height + 6), half = height / 2;
    if (Math.min(u, v) < half - 3 || Math.max(u, v) > state.frame.width - half + 3) return;  // cut by the edge: keep the last whole one
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, 96, 96);
    pen.drawImage(state.frame, u - side / 2, v - side / 2, side, side, 0, 0, 96, 96);
  });
}

function live(message) {
  if (message.time === null || (state.live.time ?? 0) > message.time || state.live.stage !== message.stage) {
    state.path = [];
    if (message.time === null || (state.live.time ?? 0) > message.time) state.traces = [];
  }
  state.live = message;
  $("goals").hidden = !message.goals?.length;
  $("goals").replaceChildren(...(message.goals ?? []).map(([text, at]) => make("li", { className: at.replace(" ", "-"), textContent: text, title: at })));
  panels(message.seen ?? []);
  $("heard").textContent = message.heard?.length && message.seen?.length
    ? `the words are nearest to ${message.heard.map(([what, fit]) => `${what} (${fit})`).join(", ")}` : "";
  $("directive").textContent = message.directive
    ? `“${message.directive}”, ${Math.round(100 * message.confidence)} % sure, ${message.age.toFixed(1)} s old`
    : message.goals?.length || message.seen?.length || message.choice ? "" : "This pilot does not say what it reads.";
  if (!(message.seen ?? []).length && message.choice)
    $("directive").textContent = message.choice.filter((each) => each.score > 0.3).sort((a, b) => a.u - b.u)
      .map((each, i) => `gate ${i + 1}: ${Math.round(100 * each.right)} %`).join(", ");
  $("doubt").textContent = message.hold || message.guard || "";
  $("clock").textContent = message.time === null ? "" : `${message.time.toFixed(1)} s`;
  $("release").hidden = !message.taken;
  if (message.position) {
    state.path.push(message.position);
    if (state.path.length > 2000) state.path.shift();
  }
  if (message.time !== null) {
    state.traces.push({ speed: Math.hypot(...message.velocity.slice(0, 3)), policy: message.policy_ms ?? 0 });
    if (state.traces.length > 200) state.traces.shift();
    const [vx, vy, vz, turn] = message.action;
    $("numbers").textContent = `forward ${vx.toFixed(2)}, left ${vy.toFixed(2)}, up ${vz.toFixed(2)} m/s, turn ${turn.toFixed(2)} rad/s; `
      + `policy ${message.policy_ms ?? "-"} ms, ${message.late} late${message.taken ? "; you steer" : ""}`;
  }
  $("events").replaceChildren(...(message.events ?? []).slice(-14).reverse().map((event) =>
    make("li", { textContent: `${event.time.toFixed(1)} s ${event.kind} ${event.text}` })));
  drawMap($("map"), state.scene, state.path, message);
  drawSticks($("sticks"), message.action ?? [0, 0, 0, 0]);
  drawTraces($("traces"), state.traces);
}

function scene(message) {
  state.scene = message;
  state.path = [];
  if (state.session.options) session(state.session);
  drawMap($("map"), message, [], state.live);
}

// --- the session
function phase(name) {
  $("phase").textContent = name;
  $("phase").className = name;
}

function notice(sentence, bad = false) {
  $("notice").textContent = sentence;
  $("notice").classList.toggle("bad", bad);
}

function session(message) {
  const before = state.session;
  state.session = message;
  phase(message.phase);
  $("pilot").textContent = message.pilot;
  history(message.sentences);
  $("command").textContent = message.command;
  for (const key of document.querySelectorAll("[data-do=hold], #keys")) key.hidden = !message.steered;
  if (message.mode === "flight") {  // the page of `fly`: no scenes to choose
    for (const name of ["scene", "keep"]) $(name).hidden = true;
    for (const each of document.querySelectorAll("[data-do=scene], [data-do=repeat]")) each.hidden = true;
    return;
  }
  if (message.notice || before.notice) notice(message.notice, true);
  const outcome = $("outcome");
  outcome.hidden = !message.outcome.headline || message.phase === "flying";
  outcome.className = message.outcome.kind ?? "";
  outcome.firstElementChild.textContent = message.outcome.headline ?? "";
  outcome.lastElementChild.textContent = message.outcome.text ?? "";
  for (const tab of document.querySelectorAll("[data-mode]")) tab.setAttribute("aria-pressed", tab.dataset.mode === message.mode);
  $("mine").hidden = message.mode !== "mine";
  $("suite").hidden = message.mode !== "suite";
  const right = !message.revealed ? "" : message.target === null ? " No gate is right." : ` Gate ${message.target + 1} is right.`;
  $("task").textContent = message.mode === "words" && message.phase !== "flying" && !message.outcome.headline
    ? "Type a sentence: a scene is made for it. Until then, one stands here."
    : message.phase === "flying" && state.scene.gates.length ? `(${state.scene.gates.map((gate) => gate.name || gate.look).join(", ")})`
    : `${message.mode === "suite" ? `“${message.instruction}” ` : ""}(${message.options.join(", ")})${right}`;
  if ($("suites").children.length !== message.suites.length)
    $("suites").replaceChildren(...message.suites.map((name) => make("option", { value: name, textContent: name })));
  $("suites").value = message.suite;
  if (document.activeElement !== $("episode")) $("episode").value = message.episode;
  $("record").checked = message.record;
  $("film").hidden = message.film === null;
  if (message.film !== null) $("film").href = `film/0/${message.film}`;
  $("folder").textContent = `recorded in ${message.folder}`;
  lesson(message.lesson);
  const key = JSON.stringify([message.pictures, message.options, message.seed, message.mode]);
  if (key !== state.slots) { state.slots = key; slots(message); }
}

function history(sentences) {
  $("history").replaceChildren(...sentences.slice().reverse().map((each) => {
    const again = make("button", { type: "button", textContent: each.text });
    again.onclick = () => { $("text").value = each.text; $("text").focus(); };
    return make("li", {}, again);
  }));
}

function lesson(lesson) {
  $("lesson").hidden = !lesson || lesson.done;
  if (lesson) { $("lesson").value = lesson.share; $("lesson-text").textContent = lesson.text; }
  $("teach").disabled = Boolean(lesson && !lesson.done);
}

function slots(message) {
  $("slots").replaceChildren(...[0, 1, 2].map((slot) => {
    const own = message.pictures[slot];
    const name = make("input", { type: "text", value: own ?? "", placeholder: "what it shows", maxLength: 40 });
    name.setAttribute("aria-label", `what picture ${slot + 1} shows`);
    const file = make("input", { type: "file", accept: "image/png,image/jpeg,image/webp" });
    file.onchange = () => file.files[0] && upload(slot, file.files[0], name.value);
    const image = make("img", { src: `picture/${slot}?${Date.now()}`, alt: own ?? message.options[slot] ?? "" });
    const camera = make("button", { type: "button", textContent: "camera" });
    const card = make("div", { className: "slot" }, image, name, make("label", {}, "choose", file), camera);
    camera.onclick = () => photograph(card, image, (shot) => upload(slot, shot, name.value));
    camera.hidden = !navigator.mediaDevices;  // browsers allow it on this machine, and with TLS
    if (own) {
      const clear = make("button", { type: "button", className: "away", textContent: "take away" });
      clear.onclick = () => send("clear", { slot });
      card.append(clear);
    }
    card.ondragover = (event) => { event.preventDefault(); card.classList.add("over"); };
    card.ondragleave = () => card.classList.remove("over");
    card.ondrop = (event) => {
      event.preventDefault();
      card.classList.remove("over");
      if (event.dataTransfer.files[0]) upload(slot, event.dataTransfer.files[0], name.value);
    };
    name.onchange = () => own && name.value.trim() && send("rename", { slot, name: name.value });
    return card;
  }));
}

// The camera's picture in the place of the panel's, until it is taken or called off.
async function photograph(card, image, take) {
  let stream;
  try { stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment" } }); } catch (error) {
    notice(`no camera: ${error.message}; choose a file instead`, true);
    return;
  }
  const video = make("video", { srcObject: stream, muted: true, playsInline: true, autoplay: true });
  const shoot = make("button", { type: "button", textContent: "take it" });
  const cancel = make("button", { type: "button", textContent: "cancel" });
  const end = () => stream.getTracks().forEach((track) => track.stop());
  const rest = [...card.children];
  cancel.onclick = () => { end(); card.replaceChildren(...rest); };
  shoot.onclick = () => {
    const size = Math.min(video.videoWidth, video.videoHeight), canvas = make("canvas", { width: 512, height: 512 });
    const left = (video.videoWidth - size) / 2, top = (video.videoHeight - size) / 2;
    canvas.getContext("2d").drawImage(video, left, top, size, size, 0, 0, 512, 512);
    cancel.onclick();
    canvas.toBlob((shot) => take(new File([shot], "photograph.jpg", { type: shot.type })), "image/jpeg", 0.9);
  };
  image.replaceWith(video);
  card.append(shoot, cancel);
}

async function upload(slot, file, name) {
  if (file.size > 20e6) { notice("the picture has more than 20 MB; send a smaller one", true); return; }
  notice(`sending ${file.name}`);
  const at = new URL(`picture/${slot}`, location.href);
  at.searchParams.set("name", name.trim() || file.name);
  try {
    const answer = await fetch(at, { method: "POST", body: file });
    const { error } = await answer.json();
    notice(error ?? "", Boolean(error));
  } catch { notice("the picture could not be sent; is it too large?", true); }
}

// --- what the person does
$("say").onsubmit = (event) => {
  event.preventDefault();
  const sentence = $("text").value.trim();
  if (!sentence) return;
  send("say", { text: sentence });
  $("text").value = "";
  notice(`you said: ${sentence}`);
};
document.addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (!button) return;
  if (button.dataset.do) send(button.dataset.do, button.dataset.next ? { next: true } : {});
  if (button.dataset.mode) send("scene", { mode: button.dataset.mode });
  if (button.dataset.step) send("scene", { mode: "suite", episode: Math.max(0, state.session.episode + Number(button.dataset.step)) });
});
$("own").onclick = () => send("say", { text: state.session.instruction });
$("suites").onchange = () => send("scene", { mode: "suite", suite: $("suites").value, episode: 0 });
$("episode").onchange = () => send("scene", { mode: "suite", episode: Number($("episode").value) });
$("record").onchange = () => send("record", { on: $("record").checked });

const keys = { w: [1, 0, 0, 0], s: [-1, 0, 0, 0], a: [0, 1, 0, 0], d: [0, -1, 0, 0], r: [0, 0, 1, 0], f: [0, 0, -1, 0], q: [0, 0, 0, 1], e: [0, 0, 0, -1] };
const down = new Set();
let sticks = null;
function steer() {
  const action = [0, 0, 0, 0];
  for (const key of down) keys[key].forEach((each, i) => { action[i] += 0.7 * each; });
  send("stick", { action });
  if (!down.size) { clearInterval(sticks); sticks = null; }
}
document.addEventListener("keydown", (event) => {
  if (event.target.closest("input, select, button") || event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.toLowerCase();
  if (keys[key]) {
    down.add(key);
    if (!sticks && state.session.phase === "flying") { steer(); sticks = setInterval(steer, 100); }
  } else if (key === " ") send("hold");
  else if (key === "enter") { down.clear(); clearInterval(sticks); sticks = null; send("release"); }
  else if (key === "l") send("land");
  else return;
  event.preventDefault();
});
document.addEventListener("keyup", (event) => down.delete(event.key.toLowerCase()));
addEventListener("blur", () => down.clear());
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => event.preventDefault());
connect();

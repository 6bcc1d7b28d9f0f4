// Recorded runs side by side, with one time slider.
const $ = (id) => document.getElementById(id);
const videos = () => [...document.querySelectorAll("#replay video")];
let shown = null, length = 1;

export function replay(message, send) {
  document.querySelector("main").hidden = true;
  $("recorded").hidden = false;
  const turn = (episode) => send("scene", { episode });
  const { episodes, episode, runs } = message, at = episodes.indexOf(episode);
  if ($("turn").children.length !== episodes.length)
    $("turn").replaceChildren(...episodes.map((each) => Object.assign(document.createElement("option"), { value: each, textContent: `episode ${each}` })));
  $("turn").value = episode;
  $("turn").onchange = () => turn(Number($("turn").value));
  for (const button of document.querySelectorAll("[data-turn]")) {
    const next = episodes[at + Number(button.dataset.turn)];
    button.disabled = next === undefined;
    button.onclick = () => turn(next);
  }
  if (shown === episode) return;
  shown = episode;
  $("replay").replaceChildren(...runs.map((run, index) => {
    const card = document.createElement("article"), title = document.createElement("p"), video = document.createElement("video");
    title.textContent = `${run.pilot}: ${run.outcome} (${run.task}); ${run.name}`;
    const note = Object.assign(document.createElement("p"), { className: "hint", textContent: "the film is being made, if there is none yet" });
    video.muted = true;
    video.preload = "auto";
    video.onloadedmetadata = () => { note.textContent = ""; length = Math.max(...videos().map((each) => each.duration || 0)); };
    video.onerror = async () => { note.textContent = (await (await fetch(`film/${index}/${episode}`)).json()).error ?? "no film"; };
    video.src = `film/${index}/${episode}`;
    card.append(title, video, note);
    return card;
  }));
}

$("run").onclick = () => {
  const playing = videos().some((each) => !each.paused);
  for (const video of videos()) {
    if (playing) video.pause();
    else { if (video.ended) video.currentTime = 0; video.play(); }
  }
  $("run").textContent = playing ? "Play" : "Pause";
};
$("time").oninput = () => { for (const video of videos()) video.currentTime = Math.min(video.duration || 0, ($("time").value / 1000) * length); };
setInterval(() => {
  const now = Math.max(0, ...videos().map((each) => each.currentTime));
  $("at").textContent = videos().length ? `${now.toFixed(1)} of ${length.toFixed(1)} s` : "";
  if (document.activeElement !== $("time")) $("time").value = (1000 * now) / length;
  if (!videos().some((each) => !each.paused && !each.ended)) $("run").textContent = "Play";
}, 200);

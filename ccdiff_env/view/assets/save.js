// What is seen, as a picture or a clip: the panes on one canvas, with titles, verdicts and the time.

const CLIP_FPS = 30;

/** The panes as they lie on the screen, drawn onto a canvas. */
function drawStage(player, canvas) {
  const ratio = window.devicePixelRatio || 1, stage = player.stage.getBoundingClientRect();
  const context = canvas.getContext("2d"), colours = COLOURS[player.theme];
  resizeCanvas(canvas, 2 * Math.round(stage.width / 2), 2 * Math.round(stage.height / 2), ratio);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.fillStyle = colours.ground;
  context.fillRect(0, 0, stage.width, stage.height);
  context.textBaseline = "top";
  context.lineWidth = 4;
  context.lineJoin = "round";
  context.strokeStyle = `${colours.paper}d9`;
  for (const pane of player.panes) {
    if (!pane.width) continue;
    const box = pane.canvas.getBoundingClientRect();
    const [x, y] = [box.left - stage.left, box.top - stage.top];
    context.drawImage(pane.canvas, x, y, box.width, box.height);
    const { title, outcome: { tone, text } } = pane.run;
    const clock = `${(player.time - player.start).toFixed(1)} s`;
    [[`${title}  ${clock}`, "ink"], [text, { bad: "collision", good: "goal" }[tone] || "ink"]]
      .forEach(([words, colour], row) => {
        context.font = `600 ${row ? 13 : 15}px system-ui, sans-serif`;
        context.fillStyle = colours[colour];
        context.strokeText(words, x + 12, y + 10 + 22 * row, box.width - 24);
        context.fillText(words, x + 12, y + 10 + 22 * row, box.width - 24);
      });
  }
}

/** Give the reader a file. */
function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

function fileName(player, suffix) {
  const scene = document.querySelector("h1").textContent.replace(/[^\w.-]+/g, "-");
  return `${scene}-${(player.time - player.start).toFixed(1)}s.${suffix}`;
}

function savePicture(player) {
  const canvas = document.createElement("canvas");
  drawStage(player, canvas);
  canvas.toBlob((blob) => download(blob, fileName(player, "png")), "image/png");
}

/** Play from here to the end, or from the start, and save what is seen; a second call ends it early. */
function saveClip(player, button) {
  if (player.clip) return player.clip.stop();
  const canvas = document.createElement("canvas"), parts = [], name = fileName(player, "webm");
  drawStage(player, canvas);
  const recorder = new MediaRecorder(canvas.captureStream(CLIP_FPS), { videoBitsPerSecond: 6e6 });
  recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
  recorder.addEventListener("stop", () => {
    player.clip = null;
    button.classList.remove("done");
    download(new Blob(parts, { type: "video/webm" }), name);
  });
  player.clip = {
    stop: () => recorder.state === "recording" && recorder.stop(),
    draw: () => {
      drawStage(player, canvas);
      if (!player.playing) setTimeout(player.clip.stop, 1000); // the verdict can be read
    },
  };
  button.classList.add("done");
  recorder.start();
  if (player.time >= player.end - 1e-6) player.seek(player.start);
  player.loop = false;
  player.playing = true;
  player.touch();
}

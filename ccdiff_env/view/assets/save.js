// What is seen, as a picture: the panes on one canvas, with titles, verdicts and the time.

/** The panes as they lie on the screen, drawn onto a canvas. */
function drawStage(player, canvas) {
  const stage = player.stage.getBoundingClientRect(), colours = COLOURS[player.theme];
  const context = clearedContext(canvas, 2 * Math.round(stage.width / 2), 2 * Math.round(stage.height / 2));
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

function savePicture(player) {
  const canvas = document.createElement("canvas"), link = document.createElement("a");
  const scene = document.querySelector("h1").textContent.replace(/[^\w.-]+/g, "-");
  drawStage(player, canvas);
  link.download = `${scene}-${(player.time - player.start).toFixed(1)}s.png`;
  canvas.toBlob((blob) => {
    link.href = URL.createObjectURL(blob);
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  });
}

// A run while it goes on: its curves, and its newest replay.

const SECONDS = 3;
const curves = document.getElementById("curves"), frame = document.getElementById("frame");
let shown = null;

async function look() {
  try {
    const state = await (await fetch("/state")).json();
    document.getElementById("state").textContent = state.line;
    draw(state.curves);
    if (state.replay !== shown) {
      shown = state.replay;
      if (shown !== null) frame.src = `/replay?key=${encodeURIComponent(shown)}`;
    }
  } catch {
    document.getElementById("state").textContent = "the server has ended";
  }
  setTimeout(look, SECONDS * 1000);
}

function draw(found) {
  while (curves.childElementCount > found.length) curves.lastChild.remove();
  found.forEach((curve, i) => {
    const box = curves.children[i] || curves.appendChild(document.createElement("div"));
    if (!box.firstChild) box.append(document.createElement("h2"), document.createElement("canvas"));
    const [head, canvas] = box.children, last = curve.y[curve.y.length - 1];
    head.replaceChildren(`${curve.name} `, Object.assign(document.createElement("small"), {
      textContent: `${brief(last)} at ${curve.along} ${curve.x[curve.x.length - 1].toLocaleString("en")}`,
    }));
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${curve.name}: ${brief(curve.y[0])} at first, ${brief(last)} now`);
    line(canvas, curve);
  });
}

function line(canvas, { x, y, marks }) {
  const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const context = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
  context.scale(ratio, ratio);
  const [low, high] = [Math.min(...y), Math.max(...y)], [first, last] = [x[0], x[x.length - 1]];
  const px = (v) => 4 + (width - 8) * (v - first) / (last - first || 1);
  const py = (v) => height - 16 - (height - 22) * (v - low) / (high - low || 1);
  context.strokeStyle = style.getPropertyValue("--line");
  context.strokeRect(0.5, 0.5, width - 1, height - 1);
  context.strokeStyle = style.getPropertyValue("--accent");
  // the values, faint, and their moving mean
  const half = Math.floor(y.length / 40), mean = y.map((_, i) => {
    const near = y.slice(Math.max(i - half, 0), i + half + 1);
    return near.reduce((sum, v) => sum + v, 0) / near.length;
  });
  for (const [values, alpha] of [[y, half ? 0.3 : 0], [mean, 1]]) {
    context.globalAlpha = alpha;
    context.lineWidth = alpha === 1 ? 1.8 : 1;
    context.beginPath();
    values.forEach((v, i) => (i ? context.lineTo(px(x[i]), py(v)) : context.moveTo(px(x[i]), py(v))));
    context.stroke();
  }
  context.globalAlpha = 1;
  context.fillStyle = context.strokeStyle = style.getPropertyValue("--quiet");
  context.font = "10px system-ui, sans-serif";
  context.lineWidth = 1;
  context.setLineDash([3, 3]);
  for (const [at, phase] of marks) {
    context.beginPath();
    context.moveTo(px(at), 0);
    context.lineTo(px(at), height);
    context.stroke();
    context.textAlign = px(at) > width / 2 ? "right" : "left";
    context.fillText(` ${phase} `, px(at), height - 4);
  }
  context.setLineDash([]);
  context.textAlign = "left";
  context.fillText(brief(high), 4, 11);
  context.fillText(brief(low), 4, height - 4);
}

function brief(value) {
  const size = Math.abs(value);
  return size >= 1000 ? Math.round(value).toLocaleString("en") : value.toPrecision(3);
}

look();

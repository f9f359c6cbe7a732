// The time line: where we are, and flags where something happens.

const FLAG_HEIGHTS = { ego: 16, guided: 11 };

class Timeline {
  /** seek(time) is called while the user drags. */
  constructor(canvas, runs, seek) {
    this.canvas = canvas;
    this.runs = runs;
    [this.start, this.end] = spanOf(runs);
    this.seek = seek;
    this.listen();
  }

  get span() {
    return Math.max(this.end - this.start, 1e-6);
  }

  /** Seek the time below a pointer on a canvas that has the time line's axis. */
  seekAt(event, canvas) {
    const box = canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - 10) / Math.max(box.width - 20, 1);
    this.seek(this.start + Math.min(Math.max(share, 0), 1) * this.span);
  }

  listen() {
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      this.dragging = true;
      this.seekAt(event, this.canvas);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (this.dragging) this.seekAt(event, this.canvas);
    });
    this.canvas.addEventListener("lostpointercapture", () => { this.dragging = false; });
  }

  /** Say where we are to those who do not see it. */
  speak(time) {
    this.canvas.setAttribute("aria-valuemax", this.span.toFixed(1));
    this.canvas.setAttribute("aria-valuenow", (time - this.start).toFixed(1));
  }

  draw(time, colours) {
    const { canvas } = this;
    const { clientWidth: width, clientHeight: height } = canvas, context = clearedContext(canvas, width, height);
    const x = (t) => 10 + (width - 20) * (t - this.start) / this.span;
    const middle = height - 14;
    this.ticks(context, x, height, colours);
    context.lineCap = "round";
    context.lineWidth = 5;
    context.strokeStyle = colours.track;
    line(context, x(this.start), middle, x(this.end), middle);
    context.strokeStyle = colours.accent;
    line(context, x(this.start), middle, x(time), middle);
    this.runs.forEach((run) => this.flags(context, run, x, middle, colours.flags));
    context.fillStyle = colours.accent;
    context.strokeStyle = colours.panel;
    context.lineWidth = 2;
    context.beginPath();
    context.arc(x(time), middle, 7, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
  }

  ticks(context, x, height, colours) {
    const wanted = Math.max((x(this.end) - x(this.start)) / 60, 2);
    const gap = [0.5, 1, 2, 5, 10, 20, 60].find((s) => this.span / s <= wanted) || 60;
    context.font = "10px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "top";
    for (let t = 0; t <= this.span + 1e-6; t += gap) {
      context.fillStyle = colours.faint;
      context.fillRect(x(this.start + t) - 0.5, height - 10, 1, 5);
      context.fillText(`${+t.toFixed(1)}`, x(this.start + t), 0);
    }
  }

  /** Ticks of plans below the track, flags of events above it: the ego's stand highest. */
  flags(context, run, x, middle, colours) {
    context.fillStyle = colours.plan;
    context.globalAlpha = 0.7;
    for (const plan of run.plans)
      context.fillRect(x(run.start + plan.made_at * run.dt) - 1, middle + 5, 2, 4);
    context.globalAlpha = 1;
    for (const event of run.events) {
      if (event.lane === "others") continue; // they would hide the ego's
      const at = x(run.timeOf(event)), high = FLAG_HEIGHTS[event.lane];
      context.fillStyle = colours[event.kind] || colours.other;
      context.fillRect(at - 0.75, middle - high, 1.5, high);
      context.beginPath();
      context.moveTo(at - 0.75, middle - high);
      context.lineTo(at + 7, middle - high + 3);
      context.lineTo(at - 0.75, middle - high + 6);
      context.fill();
    }
  }
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

function spanOf(runs) {
  return [Math.min(...runs.map((run) => run.start)), Math.max(...runs.map((run) => run.end))];
}

/** Context of an empty canvas that has as many pixels as its box has on the screen. */
function clearedContext(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1, context = canvas.getContext("2d");
  const wide = Math.max(Math.round(width * ratio), 1), high = Math.max(Math.round(height * ratio), 1);
  if (canvas.width !== wide || canvas.height !== high) {
    canvas.width = wide;
    canvas.height = high;
  }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

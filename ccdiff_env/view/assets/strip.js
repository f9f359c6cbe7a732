// The strip below the time line: one figure of the followed agent over time, a line for each run.

/** Figures: name, unit, most that is shown, limits of nuPlan's comfort and time to contact, and the value at a step. */
const FIGURES = {
  speed: { unit: "m/s", of: (run, agent, step) => run.speed(agent, step) },
  acceleration: { unit: "m/s²", most: 10, low: -4.05, high: 2.4, of: (run, agent, step) => run.acceleration(agent, step) },
  gap: { unit: "m", most: 50, of: (run, agent, step) => run.gap(agent, step) },
  "time to contact": { unit: "s", most: 10, low: 0.95, of: (run, agent, step) => run.meeting(agent, step)?.[2] ?? null },
};

class Strip {
  constructor(canvas, choice, timeline) {
    Object.assign(this, { canvas, choice, timeline, known: new Map() });
    for (const name of Object.keys(FIGURES)) choice.append(new Option(name));
    canvas.addEventListener("pointerdown", (event) => timeline.seekAt(event, canvas));
  }

  /** Values of a figure at every step of a run; null where there is none. */
  values(run, id) {
    const key = `${this.choice.value} ${this.timeline.runs.indexOf(run)} ${run.title} ${id}`;
    if (!this.known.has(key)) {
      const agent = run.indexOf.get(id), { of } = FIGURES[this.choice.value];
      const at = (step) => (agent !== undefined && run.valid(agent, step) ? of(run, agent, step) : null);
      this.known.set(key, Array.from({ length: run.numSteps }, (_, step) => at(step)));
    }
    return this.known.get(key);
  }

  draw(player, colours) {
    const { canvas, timeline } = this, { clientWidth: width, clientHeight: height } = canvas;
    if (!height) return;
    const context = clearedContext(canvas, width, height), style = getComputedStyle(document.documentElement);
    const { unit, most = Infinity, low, high } = FIGURES[this.choice.value];
    const held = (value) => Math.max(-most, Math.min(value, most)); // a contact stops who had it at once
    const lines = timeline.runs.map((run) => this.values(run, player.focus));
    const shown = lines.flat().filter((value) => value !== null).map(held);
    const least = Math.min(0, ...shown), top = Math.max(1, ...shown), range = top - least;
    const y = (value) => height - 4 - (height - 8) * (held(value) - least) / range;
    const x = (t) => 10 + (width - 20) * (t - timeline.start) / timeline.span;
    context.fillStyle = colours.flags.off_road;
    context.globalAlpha = 0.16; // beyond the limits of comfort
    if (high !== undefined && high < top) context.fillRect(10, 0, width - 20, y(high));
    if (low !== undefined && low > least) context.fillRect(10, y(low), width - 20, height - y(low));
    context.globalAlpha = 1;
    context.strokeStyle = colours.track;
    context.lineWidth = 1;
    line(context, 10, y(0), width - 10, y(0));
    timeline.runs.forEach((run, index) => {
      context.strokeStyle = context.fillStyle = timeline.runs.length > 1
        ? style.getPropertyValue(`--run-${player.runs.indexOf(run) % RUN_COLOURS}`) : colours.accent;
      context.lineWidth = 1.6;
      context.beginPath();
      lines[index].forEach((value, step) => {
        const before = step ? lines[index][step - 1] : null, at = x(run.start + step * run.dt);
        if (value !== null) context[before === null ? "moveTo" : "lineTo"](at, y(value));
      });
      context.stroke();
      context.fillStyle = colours.flags.collision;
      for (const event of run.events.filter(({ kind, agent, partner }) => kind === "collision"
        && [agent, partner].includes(run.indexOf.get(player.focus)))) {
        context.beginPath();
        context.arc(x(run.timeOf(event)), y(lines[index][event.step] ?? 0), 3.5, 0, 2 * Math.PI);
        context.fill();
      }
    });
    context.strokeStyle = colours.accent;
    context.lineWidth = 1;
    line(context, x(player.time), 0, x(player.time), height);
    context.font = "10px system-ui, sans-serif";
    context.textAlign = "left";
    context.textBaseline = "top";
    for (const [end, at] of least < 0 ? [[top, 0], [least, height - 13]] : [[top, 0]]) {
      const label = `${end.toFixed(Math.abs(end) < 10 ? 1 : 0)} ${unit}`;
      context.fillStyle = colours.panel;
      context.fillRect(9, at, context.measureText(label).width + 6, 13);
      context.fillStyle = colours.faint;
      context.fillText(label, 12, at + 1);
    }
  }
}

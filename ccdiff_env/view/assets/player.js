// The player: its state, the panes that show it, and the loop that draws them.

const RATES = [0.25, 0.5, 1, 2, 4, 8];
const LAYERS_AT_START = { trails: true, plans: true, graph: false, labels: true, lanes: true };
const LAYERS = Object.keys(LAYERS_AT_START);
const NEAR_M = 40; // who is nearer to the ego is to be seen at first
const LEAD_SECONDS = 2; // a way to an event ends so long before it

class Pane {
  constructor(root, run, index) {
    this.run = run;
    this.ground = new Ground(run);
    this.actors = new Actors(run);
    this.root = element("div", "pane");
    this.canvas = element("canvas", "map");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `map of ${run.title}: ${run.outcome.text}`);
    this.caption = element("div", "pane-caption");
    this.caption.append(badge(index), element("b", "", run.title), element("span", "", run.subtitle));
    this.caption.append(...verdict(run.outcome));
    this.enlarge = element("button", "enlarge", "⤢");
    this.enlarge.title = `This run alone (${index + 1}; all: 0)`;
    this.enlarge.setAttribute("aria-label", `${run.title} alone`);
    this.root.append(this.canvas, this.caption, this.enlarge);
    if (!run.layers.lanes.length) this.root.append(element("p", "pane-note", "This map has no lanes."));
    root.append(this.root);
  }

  get width() { return this.canvas.clientWidth; }
  get height() { return this.canvas.clientHeight; }

  draw(player) {
    if (!this.width) return;
    const { camera, theme, layers } = player;
    const ratio = window.devicePixelRatio || 1, { width, height } = this;
    const context = clearedContext(this.canvas, width, height);
    const colours = COLOURS[theme], pixel = 1 / camera.scale;
    context.fillStyle = colours.ground;
    context.fillRect(0, 0, width + 1, height + 1);
    camera.apply(context, width, height, ratio);
    this.ground.draw(context, colours, pixel);
    if (layers.lanes) this.ground.drawLanes(context, colours, pixel);
    const at = this.run.stepAt(player.time);
    this.ground.drawLights(context, colours, pixel, this.run.lights, at + 1e-6);
    this.scaleBar(context, camera, width, height, theme, ratio); // below road users and their names
    this.actors.draw(context, at, { layers, theme, pixel, focus: this.index(player.focus) });
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (layers.labels) this.actors.labels(context, at, camera, width, height, theme, this.index(player.focus));
    const late = player.time > this.run.end + 1e-6, early = player.time < this.run.start - 1e-6;
    this.root.classList.toggle("outside", late || early);
  }

  index(id) {
    const index = this.run.indexOf.get(id);
    return index === undefined ? -1 : index;
  }

  scaleBar(context, camera, width, height, theme, ratio) {
    const metres = [1, 2, 5, 10, 20, 50, 100, 200].find((m) => m * camera.scale >= 60) || 500;
    context.save();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const long = metres * camera.scale, x = width - 16 - long, y = innerWidth > 760 ? height - 16 : 30;
    context.strokeStyle = context.fillStyle = COLOURS[theme].ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(x, y - 5);
    context.lineTo(x, y);
    context.lineTo(x + long, y);
    context.lineTo(x + long, y - 5);
    context.stroke();
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "bottom";
    context.strokeStyle = `${COLOURS[theme].paper}d9`;
    context.lineWidth = 3;
    context.strokeText(`${metres} m`, x + long / 2, y - 4);
    context.fillText(`${metres} m`, x + long / 2, y - 4);
    context.restore();
  }

  /** Id of the agent under a pixel, or null. */
  find(camera, px, py, time, slackPixels) {
    const [x, y] = camera.toMap(px, py, this.width, this.height);
    const agent = this.actors.find(x, y, this.run.stepAt(time), slackPixels / camera.scale);
    return agent < 0 ? null : this.run.agents[agent].id;
  }
}

/** What panes draw by. Subclasses `move` by seconds that have gone by, and `draw` where something changed. */
class View {
  camera = new Camera();
  theme = "light";
  headingUp = false;
  before = 0;
  dirty = true;
  layers = { ...LAYERS_AT_START };

  constructor() {
    requestAnimationFrame((now) => this.frame(now));
  }

  touch() {
    this.dirty = true;
  }

  frame(now) {
    this.move(Math.min((now - this.before) / 1000, 0.1));
    this.before = now;
    if (this.dirty) {
      this.dirty = false;
      this.draw();
    }
    requestAnimationFrame((next) => this.frame(next));
  }
}

/** State of the page and everything that changes it. Times are seconds of the scene. */
class Player extends View {
  constructor(runs, stage, changed) {
    super();
    this.runs = runs;
    this.stage = stage;
    this.panes = runs.map((run, index) => new Pane(stage, run, index));
    [this.start, this.end] = spanOf(runs);
    this.step = Math.min(...runs.map((run) => run.dt));
    this.time = this.start + runs[0].opening;
    this.rate = 1;
    this.playing = false;
    this.focus = runs[0].agents.length ? runs[0].agents[0].id : null;
    this.follow = this.focus;
    this.alone = null; // index of the run that has the stage to itself
    this.showing = () => {};
    this.changed = changed;
    this.show(null);
  }

  move(elapsed) {
    if (!this.playing) return;
    this.time = Math.min(this.time + elapsed * this.rate, this.end);
    this.playing = this.time < this.end;
    this.touch();
  }

  draw() {
    this.track();
    for (const pane of this.panes) pane.draw(this);
    this.changed(this);
  }

  /** Keep the followed agent in the middle. */
  track() {
    const poses = this.runs.filter((run) => run.indexOf.has(this.follow))
      .map((run) => run.pose(run.indexOf.get(this.follow), run.stepAt(this.time)));
    const pose = poses.find(Boolean);
    if (!pose) return;
    this.camera.x = pose.x;
    this.camera.y = pose.y;
    this.camera.right = this.headingUp ? pose.heading - Math.PI / 2 : 0;
  }

  togglePlay() {
    if (!this.playing && this.time >= this.end - 1e-6) this.time = this.start;
    this.playing = !this.playing;
    this.touch();
  }

  seek(time) {
    this.time = Math.min(Math.max(time, this.start), this.end);
    this.touch();
  }

  /** Stop, and go by whole steps. */
  stepBy(steps) {
    this.playing = false;
    const at = Math.round((this.time - this.start) / this.step);
    this.seek(this.start + (at + steps) * this.step);
  }

  toggle(layer) {
    this.layers[layer] = !this.layers[layer];
    this.touch();
  }

  /** Zoom so that whoever is near the ego is seen; a road that crosses a tall pane goes up. */
  frameNeighbours() {
    this.framed = true;
    const { width, height, run } = this.shown, at = run.stepAt(this.time);
    const ego = run.indexOf.get(this.follow), here = ego === undefined ? null : run.pose(ego, at);
    let reach = 0;
    run.agents.forEach((_, agent) => {
      const pose = here && !run.agents[agent].still && run.pose(agent, at);
      const far = pose ? Math.hypot(pose.x - here.x, pose.y - here.y) : 0;
      if (far < NEAR_M) reach = Math.max(reach, far);
    });
    reach = Math.max(Math.min(reach + 6, 38), 24);
    this.camera.scale = Math.max(Math.min(width, height) / (2 * reach), 4.5);
    if (height > 1.2 * width && here) this.headingUp = true;
  }

  /** Give the stage to one run, or back to all of them; what has it keeps it where it is to stay. */
  show(index, stay = false) {
    this.alone = (index === this.alone && !stay) || !this.panes[index] ? null : index;
    this.panes.forEach((pane, i) => {
      pane.root.hidden = this.alone !== null && i !== this.alone;
      pane.enlarge.setAttribute("aria-pressed", i === this.alone);
    });
    const seen = this.alone === null ? this.panes.length : 1;
    this.stage.style.setProperty("--columns", seen < 4 ? seen : Math.ceil(Math.sqrt(seen)));
    document.body.classList.toggle("alone", this.alone !== null);
    this.showing();
    if (!stay && this.framed) this.frameNeighbours(); // the pane has another size
    this.touch();
  }

  /** Runs of which the panels speak. */
  get told() { return this.alone === null ? this.runs : [this.runs[this.alone]]; }

  /** The first pane that is seen. */
  get shown() { return this.panes[this.alone ?? 0]; }

  choose(id) {
    this.focus = id;
    this.touch();
  }

  followAgent(id) {
    this.follow = id;
    if (id !== null) this.focus = id;
    this.touch();
  }

  headUp(wanted) {
    this.headingUp = wanted;
    if (!this.headingUp) this.camera.right = 0;
    if (this.headingUp && this.follow === null) this.follow = this.focus;
    this.touch();
  }

  fit() {
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    for (const { agents, numSteps, a: { x, y, valid } } of this.runs)
      valid.forEach((there, i) => {
        if (!there || agents[Math.floor(i / numSteps)].kind === "static") return;
        [x[i], y[i]].forEach((value, axis) => {
          box[axis] = Math.min(box[axis], value - 5);
          box[axis + 2] = Math.max(box[axis + 2], value + 5);
        });
      });
    if (!Number.isFinite(box[0])) return;
    this.follow = null;
    this.headingUp = false;
    this.camera.fit(box, this.shown.width, this.shown.height);
    this.touch();
  }

  /** Go to a moment before an event of a run, follow its agent, and play. */
  goTo(run, event) {
    this.seek(Math.max(run.timeOf(event) - LEAD_SECONDS, this.start));
    this.followAgent(run.agents[event.agent].id);
    this.playing = true;
  }
}

// Reading the packed runs: base64 → inflate → JSON. See pack.py for the layout.

// What pictures and this page draw alike: colours by theme and name, words, times and lengths (rust/render).
const SETTINGS = JSON.parse(document.getElementById("settings").textContent);
const { colours: COLOURS, look: LOOK } = SETTINGS;

async function inflate(element) {
  const text = atob(element.textContent.trim());
  const packed = Uint8Array.from(text, (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

async function readRun(element) {
  return new Run(JSON.parse(new TextDecoder().decode(await inflate(element))));
}

/** Values of an array that holds differences. */
function valuesOf({ step, row, deltas }) {
  let sum = 0;
  return Float32Array.from(deltas, (delta, i) => step * (sum = (i % row ? sum : 0) + delta));
}

/** One recorded episode: agents, their states, events, plans, info columns and the map. */
class Run {
  constructor({ run, layers, arrays, plans, intentions }) {
    Object.assign(this, run, { layers });
    this.a = Object.fromEntries(Object.entries(arrays).map(([name, array]) => [name, valuesOf(array)]));
    this.order = this.agents.map((_, index) => index).sort((p, q) => this.height(p) - this.height(q));
    this.plans = plans.map((plan) => ({ ...plan, x: valuesOf(plan.x), y: valuesOf(plan.y) }));
    this.intentions = intentions.map((meant) => ({ ...meant, x: valuesOf(meant.x), y: valuesOf(meant.y) }));
    this.indexOf = new Map(this.agents.map((agent, index) => [agent.id, index]));
    const goal = this.events.find((event) => event.kind === "goal" && event.lane === "ego");
    this.goal = goal && { agent: goal.agent, step: goal.step };
  }

  /** Seconds of the scene at the first and the last recorded state. */
  get start() { return this.startStep * this.dt; }
  get end() { return this.start + (this.numSteps - 1) * this.dt; }

  /** Seconds of the scene at which an event happens. */
  timeOf(event) { return this.start + event.step * this.dt; }

  /** Fractional step at a time of the scene, kept inside the run. */
  stepAt(time) {
    return Math.min(Math.max((time - this.start) / this.dt, 0), this.numSteps - 1);
  }

  valid(agent, step) {
    return this.a.valid[agent * this.numSteps + step] === 1;
  }

  /** What is drawn on top: obstacles lowest, the ego highest. */
  height(agent) {
    const { kind, driver } = this.agents[agent];
    if (driver === "ego") return 4;
    return kind === "static" ? 0 : driver === "replay" ? 1 : kind === "vehicle" ? 2 : 3;
  }

  /** Whether the ego has reached its goal: it is drawn where it left the scene. */
  arrived(agent, step) {
    return this.goal?.agent === agent && step >= this.goal.step;
  }

  /** Pose of an agent at a fractional step, or null where it is absent. */
  pose(agent, at) {
    const step = Math.floor(at + 1e-6), t = Math.max(at - step, 0);
    if (!this.valid(agent, step) && !this.arrived(agent, step)) return null;
    const i = agent * this.numSteps + step;
    const { x, y, heading, vx, vy } = this.a;
    const pose = { x: x[i], y: y[i], heading: heading[i], vx: vx[i], vy: vy[i] };
    if (t < 1e-3 || step + 1 >= this.numSteps || !this.valid(agent, step + 1)) return pose;
    const mix = (values) => values[i] + t * (values[i + 1] - values[i]);
    const turn = wrap(heading[i + 1] - heading[i]);
    return { x: mix(x), y: mix(y), heading: heading[i] + t * turn, vx: mix(vx), vy: mix(vy) };
  }

  /** The first pair to meet that an agent is in, if there is one. */
  meeting(agent, step) {
    return this.pairs[step].filter(([a, b]) => a === agent || b === agent).sort((p, q) => p[2] - q[2])[0];
  }

  speed(agent, step) {
    const i = agent * this.numSteps + step;
    return Math.hypot(this.a.vx[i], this.a.vy[i]);
  }

  /** Change of an agent's speed at a step, over the steps beside it, m/s²; null where it is not there. */
  acceleration(agent, step) {
    const first = Math.max(step - 1, 0), last = Math.min(step + 1, this.numSteps - 1);
    if (first === last || !this.valid(agent, first) || !this.valid(agent, last)) return null;
    return (this.speed(agent, last) - this.speed(agent, first)) / ((last - first) * this.dt);
  }

  /** Distance from an agent's front to the rear of the nearest one in its way, metres; null without one. */
  gap(agent, step) {
    const own = this.pose(agent, step), { length, width } = this.agents[agent];
    const cos = Math.cos(own.heading), sin = Math.sin(own.heading);
    let least = null;
    this.agents.forEach((other, index) => {
      const pose = index === agent || !this.valid(index, step) ? null : this.pose(index, step);
      if (!pose) return;
      const dx = pose.x - own.x, dy = pose.y - own.y, turn = pose.heading - own.heading;
      const long = Math.abs(Math.cos(turn)) * other.length + Math.abs(Math.sin(turn)) * other.width;
      const wide = Math.abs(Math.sin(turn)) * other.length + Math.abs(Math.cos(turn)) * other.width;
      const ahead = dx * cos + dy * sin, aside = Math.abs(dy * cos - dx * sin);
      const gap = ahead - (length + long) / 2;
      if (ahead > 0 && aside < (width + wide) / 2 && (least === null || gap < least)) least = Math.max(gap, 0);
    });
    return least;
  }

  /** The plan in force at a step: the last one made by then. */
  planAt(step) {
    return this.plans.filter((plan) => plan.made_at <= step).at(-1) ?? null;
  }

  /** Influences at a step as [from, to, weight]: the plan's graph, else pairs that meet soon. */
  influences(step) {
    const plan = this.planAt(step);
    if (plan && plan.edges) return plan.edges.map(([from, to]) => [from, to, 1]);
    const out = [];
    for (const [a, b, ttc] of this.pairs[step]) {
      const solid = this.agents[a].kind === "static" || this.agents[b].kind === "static";
      if (ttc > this.graphTtc || solid) continue;
      const p = this.pose(a, step), q = this.pose(b, step);
      if (!p || !q || Math.hypot(p.x - q.x, p.y - q.y) > this.graphDistance) continue;
      const weight = 1 - ttc / this.graphTtc;
      out.push([a, b, weight], [b, a, weight]);
    }
    return out;
  }
}

/** Edges of a graph that lead to an agent by at most two steps. */
function leadingTo(edges, agent) {
  const direct = new Set(edges.filter(([, to]) => to === agent).map(([from]) => from));
  return edges.filter(([from, to]) => to === agent || (direct.has(to) && from !== agent));
}

function wrap(angle) {
  return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
}

// Agents and what belongs to them: trails, paths ahead, plans, influences, collisions, names.

/** Draws the agents of one run at a fractional step. Coordinates are metres; y points north. */
class Actors {
  constructor(run) {
    this.run = run;
  }

  colour(agent, theme) {
    const { driver, kind } = this.run.agents[agent];
    return COLOURS[theme][kind === "static" ? "static obstacle" : driver];
  }

  /** Everything, in order; options hold layers, theme, pixel (metres a CSS pixel), the agent in focus. */
  draw(context, at, options) {
    const { layers, theme, pixel } = options;
    const step = Math.floor(at + 1e-6);
    const poses = this.run.agents.map((_, agent) => this.run.pose(agent, at));
    if (layers.trails) this.trails(context, at, poses, theme, pixel);
    if (options.focus >= 0) this.ahead(context, step, options.focus, theme, pixel);
    if (layers.plans) this.plans(context, step, theme, pixel, options.focus);
    if (layers.plans) this.intentions(context, step, theme, pixel);
    const hit = new Set(this.recent(step).flatMap((event) => [event.agent, event.partner]));
    for (const agent of this.run.order) {
      const arrived = this.run.arrived(agent, step), pose = poses[agent];
      if (pose) this.body(context, agent, pose, { theme, pixel, hit: hit.has(agent), arrived });
    }
    this.rescue(context, at, pixel);
    if (layers.graph) this.influences(context, step, poses, theme, pixel, options.focus);
    const focus = poses[options.focus];
    if (focus && this.run.agents[options.focus].driver !== "ego") this.ring(context, options.focus, focus, theme, pixel);
    this.marks(context, step, poses, theme, pixel);
  }

  trails(context, at, poses, theme, pixel) {
    const { run } = this;
    const step = Math.floor(at + 1e-6), count = Math.round(LOOK.TRAIL_S / run.dt);
    const first = Math.max(step - count, 0);
    context.lineWidth = Math.max(0.35, 1.6 * pixel);
    context.lineCap = "butt";
    poses.forEach((pose, agent) => {
      const base = agent * run.numSteps;
      if (!pose || !run.valid(agent, first) && Math.hypot(pose.vx, pose.vy) < 0.3) return;
      if (run.valid(agent, first)
        && Math.hypot(pose.x - run.a.x[base + first], pose.y - run.a.y[base + first]) < 0.6) return;
      context.strokeStyle = this.colour(agent, theme);
      for (let segment = 0; segment < LOOK.TRAIL_PARTS; segment++) {
        const from = step - Math.round(count * (LOOK.TRAIL_PARTS - segment) / LOOK.TRAIL_PARTS);
        const to = step - Math.round(count * (LOOK.TRAIL_PARTS - segment - 1) / LOOK.TRAIL_PARTS);
        context.globalAlpha = 0.08 + 0.42 * (segment + 1) / LOOK.TRAIL_PARTS;
        const open = this.trace(context, agent, Math.max(from, 0), to);
        if (open && segment === LOOK.TRAIL_PARTS - 1) context.lineTo(pose.x, pose.y);
        context.stroke();
      }
    });
    context.globalAlpha = 1;
  }

  /** Begin a path along an agent's places at some steps; returns whether it is there at the last. */
  trace(context, agent, first, last) {
    const { run } = this, { x, y } = run.a;
    let open = false;
    context.beginPath();
    for (let step = first; step <= last; step++) {
      const i = agent * run.numSteps + step, there = run.valid(agent, step);
      if (there && open) context.lineTo(x[i], y[i]);
      else if (there) context.moveTo(x[i], y[i]);
      open = there;
    }
    return open;
  }

  /** The rest of an agent's path in this run: a broad band. */
  ahead(context, step, agent, theme, pixel) {
    context.strokeStyle = this.colour(agent, theme);
    context.globalAlpha = LOOK.PATH_ALPHA;
    context.lineCap = context.lineJoin = "round";
    context.lineWidth = Math.max(1.6, 3 * pixel);
    this.trace(context, agent, step, this.run.numSteps - 1);
    context.stroke();
    context.globalAlpha = 1;
  }

  /**
   * Samples of the plan in force, thin; the selected (first) ones over them, thick, fading with time.
   * Those of the focus have full strength. Of agents that do not follow their plan only the focus
   * has it drawn, dashed.
   */
  plans(context, step, theme, pixel, focus) {
    const plan = this.run.planAt(step);
    if (!plan) return;
    const about = plan.agents.includes(focus) && focus !== 0;
    context.lineCap = context.lineJoin = "round";
    for (const chosen of [false, true]) {
      context.lineWidth = Math.max(chosen ? 0.3 : 0.1, (chosen ? 2 : 1) * pixel);
      plan.agents.forEach((agent, row) => {
        if (!plan.follows_plan[row] && agent !== focus) return;
        context.strokeStyle = plan.guided[row]
          ? COLOURS[theme].adversary : this.colour(agent, theme);
        context.setLineDash(plan.follows_plan[row] ? [] : [4 * pixel, 4 * pixel]);
        const strength = (chosen ? 0.95 : 0.35) * (about && agent !== focus ? 0.4 : 1);
        this.fading(context, strength, plan.num_points, (first, last) => {
          for (let sample = 0; sample < plan.num_samples; sample++) {
            if (chosen !== (sample === 0)) continue;
            const base = (sample * plan.agents.length + row) * plan.num_points;
            context.moveTo(plan.x[base + first], plan.y[base + first]);
            for (let i = first + 1; i <= last; i++) context.lineTo(plan.x[base + i], plan.y[base + i]);
          }
        });
      });
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  /** The ego that would not have collided: hollow, in dashes. */
  rescue(context, at, pixel) {
    const { step, path } = this.run.rescue ?? { path: [] };
    const pose = path[Math.floor(at + 1e-6) - step], ego = this.run.agents.findIndex(({ driver }) => driver === "ego");
    if (!pose || ego < 0) return;
    const [x, y, heading] = pose;
    context.save();
    context.translate(x, y);
    context.rotate(heading);
    for (const [colour, dash] of [["#000c", []], ["#fff", [4 * pixel, 3 * pixel]]]) {
      context.strokeStyle = colour;
      context.lineWidth = Math.max(dash.length ? 0.18 : 0.3, (dash.length ? 1.6 : 2.6) * pixel);
      context.setLineDash(dash);
      shape(context, this.run.agents[ego], pixel);
      context.stroke();
    }
    context.restore();
  }

  /** What the ego's planner means to do: the chosen candidate bold, the others thin, the dearer the fainter. */
  intentions(context, step, theme, pixel) {
    const meant = this.run.intentions.filter((one) => one.made_at <= step).at(-1);
    if (!meant) return;
    context.strokeStyle = COLOURS[theme].ego;
    context.lineCap = context.lineJoin = "round";
    const n = meant.num_points;
    meant.share.forEach((share, i) => {
      context.lineWidth = Math.max(i ? 0.1 : 0.35, (i ? 1 : 2.6) * pixel);
      this.fading(context, i ? 0.6 - 0.45 * share : 0.95, n, (first, last) => {
        context.moveTo(meant.x[i * n + first], meant.y[i * n + first]);
        for (let k = first + 1; k <= last; k++) context.lineTo(meant.x[i * n + k], meant.y[i * n + k]);
      });
    });
    context.globalAlpha = 1;
  }

  /** Stroke a line of n points in segments, each fainter than the one before. */
  fading(context, strength, n, trace) {
    for (let segment = 0; segment < LOOK.PLAN_PARTS; segment++) {
      const first = Math.floor((n - 1) * segment / LOOK.PLAN_PARTS);
      const last = Math.floor((n - 1) * (segment + 1) / LOOK.PLAN_PARTS);
      if (last === first) continue;
      context.globalAlpha = strength * (1 - 0.8 * segment / LOOK.PLAN_PARTS);
      context.beginPath();
      trace(first, last);
      context.stroke();
    }
  }

  body(context, agent, pose, { theme, pixel, hit, arrived }) {
    const { kind, length, width, still } = this.run.agents[agent];
    const colours = COLOURS[theme], colour = this.colour(agent, theme);
    context.save();
    context.translate(pose.x, pose.y);
    context.rotate(pose.heading);
    if (kind === "vehicle" && length < LOOK.LEAST_LENGTH_PX * pixel) {
      const larger = LOOK.LEAST_LENGTH_PX * pixel / length;
      context.scale(larger, larger);
    }
    context.lineWidth = hit || arrived ? Math.max(0.3, 2.2 * pixel) : Math.max(0.08, 0.8 * pixel);
    context.strokeStyle = hit ? colours.collision : arrived ? colours.goal : colours.outline;
    context.fillStyle = colour;
    const hollow = kind === "vehicle" && still;
    if (hollow && !hit) context.strokeStyle = colour;
    shape(context, this.run.agents[agent], pixel);
    context.globalAlpha = hollow ? LOOK.PARKED_ALPHA : 1;
    context.fill();
    context.globalAlpha = 1;
    context.stroke();
    if (kind === "vehicle" && !hollow && pixel < 0.4) windscreen(context, length, width, colours.outline);
    else if (kind !== "static" && kind !== "vehicle" && pixel < 0.2) nose(context, length, colours.outline);
    context.restore();
  }

  recent(step) {
    return this.run.events.filter((e) =>
      e.kind === "collision" && e.step <= step && step - e.step < LOOK.MARK_S / this.run.dt);
  }

  /** A ring half way between those that met. */
  marks(context, step, poses, theme, pixel) {
    context.strokeStyle = COLOURS[theme].collision;
    context.lineWidth = 2.5 * pixel;
    for (const event of this.recent(step)) {
      const pose = poses[event.agent], other = poses[event.partner];
      if (!pose) continue;
      const x = other ? (pose.x + other.x) / 2 : pose.x, y = other ? (pose.y + other.y) / 2 : pose.y;
      context.beginPath();
      context.arc(x, y, LOOK.MARK_M + LOOK.MARK_PX * pixel, 0, 2 * Math.PI);
      context.stroke();
    }
  }

  /** Arrows that lead to the focus within two hops; the other influences as faint lines. */
  influences(context, step, poses, theme, pixel, focus) {
    const colour = COLOURS[theme]["causal arrow"];
    const edges = this.run.influences(step), leading = new Set(leadingTo(edges, focus));
    for (const edge of edges) {
      const [from, to, weight] = edge, p = poses[from], q = poses[to];
      if (!p || !q) continue;
      const chosen = leading.has(edge), direct = chosen && to === focus;
      context.globalAlpha = chosen ? (direct ? 0.95 : 0.6) * (0.55 + 0.45 * weight) : 0.18;
      const thick = (chosen ? 1.2 + 1.3 * weight : 1) * pixel;
      arrow(context, p, q, colour, thick, chosen ? 8 * pixel : 0, this.reach(from), this.reach(to));
    }
    context.globalAlpha = 1;
  }

  /** How far an arrow stays away from the centre of an agent, metres. */
  reach(agent) {
    return Math.min(this.run.agents[agent].width / 2 + 0.4, 1.8);
  }

  ring(context, agent, pose, theme, pixel) {
    const { length, width } = this.run.agents[agent];
    context.strokeStyle = COLOURS[theme].ink;
    context.lineWidth = 1.4 * pixel;
    context.setLineDash([4 * pixel, 3 * pixel]);
    context.beginPath();
    context.arc(pose.x, pose.y, Math.hypot(length, width) / 2 + 5 * pixel, 0, 2 * Math.PI);
    context.stroke();
    context.setLineDash([]);
  }

  /** Names beside the agents, in the pixels of the pane; of walkers where there is room. */
  labels(context, at, camera, width, height, theme, focus) {
    const colours = COLOURS[theme];
    context.font = "600 11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "bottom";
    context.lineWidth = 3;
    context.lineJoin = "round";
    context.strokeStyle = `${colours.paper}d9`;
    context.fillStyle = colours.ink;
    this.run.agents.forEach(({ kind, label, length, width: wide }, agent) => {
      const small = kind === "static" || camera.scale < (kind === "pedestrian" ? 14 : 3.5);
      if (small && agent !== focus) return;
      const pose = this.run.pose(agent, at);
      if (!pose) return;
      const [x, y] = camera.toScreen(pose.x, pose.y, width, height);
      if (x < -20 || y < -20 || x > width + 20 || y > height + 20) return;
      const turn = pose.heading - camera.right; // clear of the box, whichever way it points
      const half = (length * Math.abs(Math.sin(turn)) + wide * Math.abs(Math.cos(turn))) / 2;
      const above = y - Math.max(half * camera.scale, 4) - 3;
      context.strokeText(label, x, above);
      context.fillText(label, x, above);
    });
  }

  /** The agent under a point of the map, or -1; the slack is in metres. */
  find(x, y, at, slack) {
    let best = -1, least = Infinity;
    this.run.agents.forEach(({ length, width }, agent) => {
      const pose = this.run.pose(agent, at);
      if (!pose) return;
      const dx = x - pose.x, dy = y - pose.y;
      const cos = Math.cos(pose.heading), sin = Math.sin(pose.heading);
      const u = Math.max(Math.abs(dx * cos + dy * sin) - length / 2, 0);
      const v = Math.max(Math.abs(dy * cos - dx * sin) - width / 2, 0);
      const gap = Math.hypot(u, v);
      if (gap <= slack && gap < least) { least = gap; best = agent; }
    });
    return best;
  }
}

/** Outline of an agent that is at the origin and heads to the right. */
function shape(context, { kind, length, width }, pixel) {
  context.beginPath();
  if (kind === "pedestrian") context.arc(0, 0, Math.max(0.38, 2.2 * pixel), 0, 2 * Math.PI);
  else context.roundRect(-length / 2, -width / 2, length, width, kind === "static" ? 0.05 : Math.min(0.28 * width, 0.6));
}

function windscreen(context, length, width, ink) {
  context.fillStyle = ink;
  context.globalAlpha = 0.42;
  context.beginPath();
  context.moveTo(0.24 * length, 0.34 * width);
  context.lineTo(0.11 * length, 0.4 * width);
  context.lineTo(0.11 * length, -0.4 * width);
  context.lineTo(0.24 * length, -0.34 * width);
  context.fill();
  context.globalAlpha = 0.22;
  context.fillRect(-0.36 * length, -0.36 * width, 0.09 * length, 0.72 * width);
  context.globalAlpha = 1;
}

function nose(context, length, ink) {
  context.fillStyle = ink;
  context.globalAlpha = 0.5;
  context.beginPath();
  context.arc(Math.min(0.3 * length, 0.5), 0, 0.13, 0, 2 * Math.PI);
  context.fill();
  context.globalAlpha = 1;
}

/**
 * A bent arrow, so that both directions of a pair can be seen; it stays away from both ends.
 * Without a head it is a line.
 */
function arrow(context, p, q, colour, width, head, gapFrom, gapTo) {
  const dx = q.x - p.x, dy = q.y - p.y, length = Math.hypot(dx, dy);
  if (length < 1e-3) return;
  const bend = Math.min(0.12 * length, 4);
  const mx = (p.x + q.x) / 2 - dy / length * bend, my = (p.y + q.y) / 2 + dx / length * bend;
  const angle = Math.atan2(q.y - my, q.x - mx), leave = Math.atan2(my - p.y, mx - p.x);
  const near = Math.min(gapFrom, 0.25 * length), short = Math.min(gapTo, 0.25 * length);
  const sx = p.x + near * Math.cos(leave), sy = p.y + near * Math.sin(leave);
  const ex = q.x - short * Math.cos(angle), ey = q.y - short * Math.sin(angle);
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = width;
  context.lineCap = "round";
  context.beginPath();
  context.moveTo(sx, sy);
  context.quadraticCurveTo(mx, my, ex - head * 0.7 * Math.cos(angle), ey - head * 0.7 * Math.sin(angle));
  context.stroke();
  if (!head) return;
  context.beginPath();
  context.moveTo(ex, ey);
  context.lineTo(ex - head * Math.cos(angle - 0.42), ey - head * Math.sin(angle - 0.42));
  context.lineTo(ex - head * Math.cos(angle + 0.42), ey - head * Math.sin(angle + 0.42));
  context.fill();
}

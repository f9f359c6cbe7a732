// What became of a drive, in the words of replays: view/contact.py and view/outcome.py compute the same.

/** Box of an agent at a step: x, y, heading, half length, half width. */
function boxOf(run, agent, step) {
  const i = agent * run.numSteps + step, { length, width } = run.agents[agent];
  return [run.a.x[i], run.a.y[i], run.a.heading[i], length / 2, width / 2];
}

/** How far two boxes are apart along forward and left of the one, and of the other, metres; negative where they overlap. */
function gapsOf(one, other) {
  const x = other[0] - one[0], y = other[1] - one[1], turned = other[2] - one[2];
  const along = Math.abs(Math.cos(turned)), across = Math.abs(Math.sin(turned));
  return [[one, other], [other, one]].flatMap(([[, , heading, length, width], [, , , far, wide]]) => {
    const c = Math.cos(heading), s = Math.sin(heading);
    return [
      Math.abs(x * c + y * s) - (length + far * along + wide * across),
      Math.abs(y * c - x * s) - (width + far * across + wide * along),
    ];
  });
}

/** Normal of the contact of two at a step, from one to the other, and the speeds that they bring to it, m/s. */
function impactOf(run, step, one, other) {
  const before = run.valid(one, step - 1) && run.valid(other, step - 1) ? step - 1 : step;
  const a = boxOf(run, one, before), b = boxOf(run, other, before);
  const moved = [[one, a], [other, b]].map(([agent, box]) => [...boxOf(run, agent, step).slice(0, 2), ...box.slice(2)]);
  const now = gapsOf(...moved);
  const closed = gapsOf(a, b).map((gap, axis) => (gap > 0 ? gap / Math.max(gap - now[axis], 1e-9) : gap));
  const turn = [a[2], a[2] + Math.PI / 2, b[2], b[2] + Math.PI / 2][closed.indexOf(Math.max(...closed))];
  const way = Math.cos(turn) * (b[0] - a[0]) + Math.sin(turn) * (b[1] - a[1]) < 0 ? -1 : 1;
  const normal = [way * Math.cos(turn), way * Math.sin(turn)];
  return [normal, along(run, one, step, normal), -along(run, other, step, normal)];
}

/** Speed of an agent along a direction, m/s. */
function along(run, agent, step, [x, y]) {
  const i = agent * run.numSteps + step;
  return run.a.vx[i] * x + run.a.vy[i] * y;
}

/** Who is in the way of the ego at a step, and for how many seconds it has waited; null where nobody is. */
function blockerOf(run, last, { waits, ahead, blocked }) {
  let found = -1, steps = 0;
  for (let step = last; step >= 0 && run.speed(0, step) < waits; step--, steps++) {
    const [x, y, heading, length, width] = boxOf(run, 0, step), middle = length + ahead / 2;
    const before = [x + middle * Math.cos(heading), y + middle * Math.sin(heading), heading, ahead / 2, width];
    const far = (agent) => Math.hypot(boxOf(run, agent, step)[0] - x, boxOf(run, agent, step)[1] - y);
    const near = run.agents.map((_, agent) => agent).filter((agent) => agent && run.valid(agent, step)
      && Math.max(...gapsOf(before, boxOf(run, agent, step))) <= 0);
    if (!near.length) break;
    if (found < 0) found = near.sort((p, q) => far(p) - far(q))[0];
  }
  const waited = (steps - 1) * run.dt;
  return waited > blocked - 1e-6 ? [found, waited] : null;
}

/** The collision of the ego with a partner at a step: what it did, and how fast they met, m/s. */
function collisionOf(run, step, partner, { words, most }) {
  const [normal, own, other] = impactOf(run, step, 0, partner), { kind, title } = run.agents[partner];
  const heading = run.a.heading[step], forwards = [Math.cos(heading), Math.sin(heading)];
  const speed = run.speed(0, step), across = normal[0] * forwards[0] + normal[1] * forwards[1];
  let did;
  if (Math.max(own, other) < most.waits) did = words.met;
  else if (own < other && !(kind === "pedestrian" && speed > most.passes))
    did = words.hit[Math.abs(across) < Math.SQRT1_2 ? "side" : across > 0 ? "front" : "rear"];
  else if (kind === "static") did = words.hits.static;
  else did = words.hits[own < speed / 2 ? "aside" : along(run, 0, step, forwards) >= 0 ? "into" : "back"];
  did = did.replace("{went}", words.goes.else).replace("{other}", () => named(title));
  return [did, Math.max(own + other, 0)];
}

/** What is said of an ego whose time has run out, and its tone. */
function endOf(run, log, last, info, { words, most }) {
  const far = [run, log].map(({ a: { x, y, valid } }) =>
    Math.max(...x.slice(0, last + 1).map((_, i) => valid[i] && Math.hypot(x[i] - x[0], y[i] - y[0]))));
  if (Math.max(...far) < most.waited) return ["plain", words.waited];
  const way = blockerOf(run, last, most);
  if (!way) return ["plain", wayOf(info, last * run.dt, { words, most })];
  const [other, seconds] = [named(run.agents[way[0]].title), way[1].toFixed(1)];
  return ["blocked", words.blocked.replace("{seconds}", seconds).replace("{other}", () => other)];
}

/** How far an ego has come whose time has run out. */
function wayOf({ speed, route_completion: share }, seconds, { words, most }) {
  const said = Math.abs(speed) >= most.waits ? words.on_its_way : words.late;
  return said.replace("{share}", Math.floor(100 * share)).replace("{seconds}", seconds.toFixed(1));
}

/** "4 (bus)" of "4 · bus". */
const named = (title) => (title.includes(" · ") ? `${title.replace(" · ", " (")})` : title);

// Everything beside the map: what happened, and captions of an agent.

const KMH = 3.6;
const RUN_COLOURS = 4;
const SOON_S = 4; // two on course to meet later are not told
const LANE_TITLES = { ego: "Ego", guided: "Guided vehicles", others: "Others" };

function element(tag, className, text) {
  const node = document.createElement(tag);
  if (className) node.className = className;
  if (text !== undefined) node.textContent = text;
  return node;
}

/** Captions of one agent at a time of the scene, as pairs of name and value. */
function captionsOf(run, agent, time) {
  const { kind, length, width, drivenBy } = run.agents[agent];
  const captions = kind === "static" ? [] : [["driven by", drivenBy]];
  const lasting = [["size", `${length.toFixed(1)} × ${width.toFixed(1)} m`]];
  if (time > run.end + 1e-6) return [...captions, ["state", `ended at ${(run.end - run.start).toFixed(1)} s`], ...lasting];
  const at = run.stepAt(time), pose = run.pose(agent, at), step = Math.floor(at + 1e-6);
  if (!pose) return [...captions, ["state", "not in the scene now"], ...lasting];
  const speed = Math.hypot(pose.vx, pose.vy);
  if (run.arrived(agent, step)) captions.push(["state", "has reached its goal"]);
  if (kind !== "static") {
    captions.push(["speed", `${speed.toFixed(1)} m/s · ${(speed * KMH).toFixed(0)} km/h`]);
    const least = run.meeting(agent, step);
    if (least && least[2] <= SOON_S) {
      const other = run.agents[least[0] === agent ? least[1] : least[0]];
      captions.push(["on course", `to meet ${other.label} in ${least[2].toFixed(1)} s`]);
    }
  }
  captions.push(...planCaptions(run, agent, step));
  return [...captions, ...lasting];
}

function planCaptions(run, agent, step) {
  const plan = run.planAt(step), row = plan ? plan.agents.indexOf(agent) : -1;
  if (row < 0) return [];
  if (run.agents[agent].driver === "ego" && !plan.follows_plan[row]) return [];
  const age = `made ${((step - plan.made_at) * run.dt).toFixed(1)} s ago`;
  const captions = [["plan", plan.follows_plan[row] ? age : `${age}, not followed`]];
  if (plan.guided[row]) captions.push(["guided, moved at 2 s", `${plan.moved_m[row].toFixed(1)} m`]);
  return captions;
}

/** Fill a list with captions: name and value, or a value for each run; the title says whose. */
function showCaptions(list, title, captions, marks) {
  list.replaceChildren(element("div", "captions-title", title));
  for (const [name, ...values] of captions) {
    const row = element("div", "caption");
    row.append(element("span", "caption-name", name));
    const both = element("span", "caption-value");
    values.forEach((value, i) => {
      const shown = element("span", "", value);
      if (values.length > 1) shown.prepend(badge(marks[i]));
      both.append(shown);
    });
    row.append(both);
    list.append(row);
  }
}

/** Letter of a run, in its colour. */
function badge(index) {
  const mark = element("i", `badge run-${index % RUN_COLOURS}`, String.fromCharCode(65 + index));
  mark.setAttribute("aria-hidden", "true");
  return mark;
}

/** What became of a run, as nodes: the ego's fate, nuPlan's word on its collision, and collisions of the others. */
function verdict({ tone, text, fault, others, rescue }) {
  const nodes = [element("strong", `verdict ${tone}`, text)];
  if (fault) nodes.push(element("span", "fault", fault));
  if (rescue) nodes.push(element("span", "rescue", rescue));
  if (others) nodes.push(element("span", "quiet", `others: ${counted(others, "collision")}`));
  return nodes;
}

const counted = (number, what) => `${number} ${what}${number === 1 ? "" : "s"}`;

/** Fill a panel with what happened, by whose it is; goTo(run, event) is called with what is clicked. */
function showEvents(container, runs, goTo) {
  container.replaceChildren();
  for (const [lane, title] of Object.entries(LANE_TITLES)) {
    const found = runs.flatMap((run, index) => run.events
      .filter((event) => event.lane === lane).map((event) => ({ run, index, event })));
    if (!found.length) continue;
    found.sort((p, q) => p.run.timeOf(p.event) - q.run.timeOf(q.event));
    const told = new Map(); // what happens at one moment in the same words in several runs is told once
    for (const { run, index, event } of found) {
      const key = `${run.timeOf(event).toFixed(2)} ${event.text}`;
      if (told.has(key)) told.get(key).indices.push(index);
      else told.set(key, { run, indices: [index], event });
    }
    const list = element("ul", "events");
    list.append(...[...told.values()].map((entry) => eventItem(entry, runs.length > 1, goTo)));
    container.append(element("h2", "events-head", `${title}: ${counted(found.length, "event")}`), list);
  }
  if (!container.childElementCount) container.append(element("p", "quiet", "No events."));
}

function eventItem({ run, indices, event }, several, goTo) {
  const item = element("li"), button = element("button", `event ${event.kind}`);
  button.append(element("span", "event-time", `${(event.step * run.dt).toFixed(1)} s`));
  if (several) button.append(...indices.map(badge));
  button.append(element("span", "", event.text));
  if (event.fault) button.append(element("i", "fault", event.fault));
  button.addEventListener("click", () => goTo(run, event));
  item.append(button);
  return item;
}

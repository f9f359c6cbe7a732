// Dark and light, and what the colours mean.

const $ = (id) => document.getElementById(id);

/** Show a theme, by default the other one. */
function setTheme(player, theme = player.theme === "dark" ? "light" : "dark") {
  player.theme = theme;
  document.documentElement.dataset.theme = theme;
  player.touch();
}

/** Fill the help with keys and what they do. */
function listKeys(keys) {
  $("keys").append(...keys.map(([key, what]) => {
    const row = element("div", "key");
    row.append(element("kbd", "", key), element("span", "", what));
    return row;
  }));
}

/** What the colours mean. */
function showLegend(player) {
  const key = `${player.theme} ${player.layers.graph} ${player.runs[0]?.agents.map((a) => a.driver)}`;
  if ($("legend").dataset.key === key) return;
  $("legend").dataset.key = key;
  $("legend").replaceChildren(...legendOf(player).map(([colour, title, hollow]) => {
    const item = element("span", "legend-item"), dot = element("i");
    item.setAttribute("role", "listitem");
    if (hollow) dot.style.boxShadow = `inset 0 0 0 1.5px ${colour}`;
    else dot.style.background = colour;
    item.append(dot, title);
    return item;
  }));
}

function legendOf(player) {
  const agents = player.runs.flatMap((run) => run.agents), colours = COLOURS[player.theme];
  const seen = new Set(agents.map((agent) => (agent.kind === "static" ? "static" : agent.driver)));
  const rows = Object.entries(SETTINGS.drivers).filter(([name]) => seen.has(name))
    .map(([name, title]) => [colours[name === "static" ? "static obstacle" : name], title]);
  if (player.runs.some((run) => run.still.some((still, i) => still && run.agents[i].kind === "vehicle")))
    rows.push([colours.ink, "parked", true]);
  if (player.layers.graph) rows.push([colours["causal arrow"], "may influence"]);
  return rows;
}

// Dark and light, and what the colours mean.

const $ = (id) => document.getElementById(id);

function setTheme(player, theme) {
  player.theme = theme;
  document.documentElement.dataset.theme = theme;
  player.touch();
}

/** What the colours mean, in the mode that is chosen. */
function showLegend(player, settings) {
  const key = `${player.theme} ${player.colourMode}`;
  if ($("legend").dataset.key === key) return;
  $("legend").dataset.key = key;
  $("legend").replaceChildren(...legendOf(player, settings).map(([colour, title]) => {
    const item = element("span", "legend-item"), dot = element("i");
    item.setAttribute("role", "listitem");
    dot.style.background = colour;
    item.append(dot, title);
    return item;
  }));
}

function legendOf(player, settings) {
  const agents = player.runs.flatMap((run) => run.agents);
  if (player.colourMode === "speed")
    return [0, 5, 10, FAST_MPS].map((v) => [speedColour(v, player.theme), `${v} m/s`]);
  if (player.colourMode === "kind") {
    const seen = new Set(agents.map((agent) => (agent.driver === "ego" ? "ego" : agent.kind)));
    return Object.entries(KIND_COLOURS[player.theme])
      .filter(([kind]) => seen.has(kind))
      .map(([kind, colour]) => [colour, kind === "static" ? settings.drivers.static : kind]);
  }
  const seen = new Set(agents.map((agent) => (agent.kind === "static" ? "static" : agent.driver)));
  const colours = player.panes[0].actors.driverColours[player.theme];
  return Object.entries(settings.drivers)
    .filter(([name]) => seen.has(name))
    .map(([name, title]) => [colours[name], title]);
}

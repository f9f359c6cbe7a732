"""A page in a real browser, as the tests of replay pages drive it."""

import time

import numpy as np

from ccdiff_env.scenes.scene_types import LIGHT_STATES
from ccdiff_env.view.render import legend


class Page:
    """A page of the browser that notes what must not happen."""

    def __init__(self, browser, file, hash="#t=0", **options):
        usual = {"viewport": {"width": 1280, "height": 800}, "reduced_motion": "reduce"}
        self.context = browser.new_context(**usual | options)
        self.page = self.context.new_page()
        self.faults, self.requests = [], []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on(
            "console", lambda m: m.type in ("error", "warning") and self.faults.append(m.text)
        )
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(file.as_uri() + hash)
        self.until("document.body.dataset.ready === 'yes'")
        self.frames()

    def frames(self, count=3):
        """Wait until some frames are drawn."""
        self.page.evaluate(
            """n => new Promise((done) => {
              const next = () => (n-- > 0 ? requestAnimationFrame(next) : done());
              next();
            })""",
            count,
        )

    def until(self, expression, seconds=90.0):
        """Wait until an expression holds. The page's own rules keep it from evaluating text."""
        end = time.monotonic() + seconds
        while not self.page.evaluate(expression):
            assert time.monotonic() < end, expression
            time.sleep(0.02)

    def __getattr__(self, name):
        return getattr(self.page, name)

    def texts(self, draws):
        """What canvases are told to write while a statement draws."""
        return self.page.evaluate(
            f"""async () => {{
              const canvas = CanvasRenderingContext2D.prototype, {{ fillText }} = canvas, said = [];
              canvas.fillText = function (...given) {{
                said.push(given[0]);
                fillText.apply(this, given);
              }};
              {draws};
              canvas.fillText = fillText;
              return said;
            }}"""
        )

    def time(self):
        return float(self.page.inner_text("#time"))

    def state(self, expression):
        self.frames()
        return self.page.evaluate(f"replay.{expression}")

    def image(self):
        """Pixels of the first map as text; equal images give equal text."""
        self.frames()
        return self.page.evaluate("document.querySelector('.map').toDataURL()")

    def screen(self, agent_id, pane=0):
        """Where an agent is on the screen."""
        return self.page.evaluate(
            """([id, pane]) => {
              const { run, canvas, width, height } = replay.panes[pane];
              const pose = run.pose(run.indexOf.get(id), run.stepAt(replay.time));
              const [x, y] = replay.camera.toScreen(pose.x, pose.y, width, height);
              const box = canvas.getBoundingClientRect();
              return [box.left + x, box.top + y];
            }""",
            [agent_id, pane],
        )

    def lights(self, player, seek, scene, start):
        """State of each light at each second, and whether its stop line has the colour of it; of
        those on the first map of a player, who is told by `seek` to show a time.
        """
        lights = scene.map_layers()["lights"]
        shares, seen = np.linspace(0.1, 0.9, 5), []
        shares = np.stack([shares, 1.0 - shares], axis=1)
        places = np.concatenate([shares @ light["stop_line"] for light in lights]).tolist()
        for second in range(9):
            self.page.evaluate(seek.format(second))
            self.frames()
            colours = self.page.evaluate(
                f"""(points) => {{
                  const {{ camera, panes: [{{ canvas, width, height }}] }} = {player};
                  const copy = new OffscreenCanvas(canvas.width, canvas.height);
                  const context = copy.getContext("2d", {{ willReadFrequently: true }});
                  const ratio = canvas.width / width;
                  context.drawImage(canvas, 0, 0);
                  return points.map(([x, y]) => {{
                    const [u, v] = camera.toScreen(x, y, width, height);
                    const on = u >= 0 && v >= 0 && u < width && v < height;
                    return on && [...context.getImageData(ratio * u, ratio * v, 1, 1).data];
                  }});
                }}""",
                places,
            )
            for i, light in enumerate(lights):
                state = LIGHT_STATES[light["states"][start + 10 * second]]
                found = [c[:3] for c in colours[5 * i : 5 * i + 5] if c]
                if len(found) == 5:
                    seen.append((state, [*legend()[f"{state} light"]] in found))
        return seen

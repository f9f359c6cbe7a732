// The map below the agents. Paths are built once, in metres, and drawn through the camera.

class Ground {
  constructor(run) {
    const ring = (array) => {
      const values = valuesOf(array), length = values.length / 2;
      return Array.from({ length }, (_, i) => [values[i], values[length + i]]);
    };
    this.paths = {};
    for (const [name, entries] of Object.entries(run.layers)) {
      const shapes = entries.map((arrays) => arrays.map(ring)), rings = shapes.flat();
      this.paths[name] = pathOf(rings, !name.includes("lane") && !name.includes("dividers"));
      if (name === "lanes") this.chevrons = chevronsOf(rings);
      if (name === "crossings") this.crossings = shapes.map(zebraOf);
    }
  }

  /** Draw through the transform that is set; pixel is the size of a CSS pixel in metres. */
  draw(context, colours, pixel) {
    const { paths } = this;
    context.lineJoin = "round";
    context.lineCap = "butt";
    this.fill(context, paths.walkways, colours.walkway);
    this.stroke(context, paths.drivable, colours.kerb, Math.max(0.3, 1.6 * pixel), []);
    this.fill(context, paths.drivable, colours["drivable area"]);
    this.fill(context, paths.carparks, colours["car park"]);
    this.fill(context, paths.stops, colours["stop area"]);
    for (const crossing of this.crossings) this.zebra(context, crossing, colours.crossing);
    this.stroke(context, paths.lane_dividers, colours["lane divider"], Math.max(0.14, pixel), [LOOK.LANE_DASH_M, LOOK.LANE_DASH_M]);
    this.stroke(context, paths.road_dividers, colours["road divider"], Math.max(0.18, pixel), []);
  }

  /** Stop lines in the colours of their lights at a step. */
  drawLights(context, colours, pixel, lights, step) {
    for (const { line: [from, to], shows } of lights) {
      const [, state] = shows.findLast(([first]) => first <= step);
      if (state === "unknown") continue;
      const path = new Path2D(), width = LOOK[`${state.toUpperCase()}_LIGHT_M`];
      path.moveTo(...from);
      path.lineTo(...to);
      this.stroke(context, path, colours[`${state} light`], Math.max(width, 3 * width * pixel), []);
    }
  }

  drawLanes(context, colours, pixel) {
    this.stroke(context, this.paths.lanes, colours["centre line"], Math.max(0.1, 0.9 * pixel), [LOOK.CENTRE_DASH_M, LOOK.CENTRE_GAP_M]);
    if (pixel < 0.3) this.stroke(context, this.chevrons, colours["centre line"], Math.max(0.14, pixel), []);
  }

  fill(context, path, colour) {
    context.fillStyle = colour;
    context.fill(path, "evenodd");
  }

  stroke(context, path, colour, width, dash) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.stroke(path);
    context.setLineDash([]);
  }

  zebra(context, crossing, colour) {
    context.save();
    context.clip(crossing.outline);
    this.stroke(context, crossing.axis, colour, crossing.width, [LOOK.STRIPE_M, LOOK.STRIPE_M]);
    context.restore();
  }
}

function pathOf(rings, close) {
  const path = new Path2D();
  for (const ring of rings) {
    ring.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
    if (close) path.closePath();
  }
  return path;
}

/** Little arrows along the lanes: the direction of traffic. */
function chevronsOf(lines) {
  const path = new Path2D(), gap = LOOK.CHEVRON_GAP_M, size = LOOK.CHEVRON_M;
  for (const line of lines) {
    let left = gap / 2;
    for (let i = 1; i < line.length; i++) {
      const [ax, ay] = line[i - 1], [bx, by] = line[i];
      const length = Math.hypot(bx - ax, by - ay);
      if (length === 0) continue;
      const ux = (bx - ax) / length, uy = (by - ay) / length;
      for (; left <= length; left += gap) {
        const x = ax + ux * left, y = ay + uy * left;
        path.moveTo(x - size * (ux - uy), y - size * (uy + ux));
        path.lineTo(x, y);
        path.lineTo(x - size * (ux + uy), y - size * (uy - ux));
      }
      left -= length;
    }
  }
  return path;
}

/** Outline of a crossing, the line that walkers take through it, and its width. */
function zebraOf(rings) {
  const ring = rings[0] || [];
  const count = Math.max(ring.length, 1);
  const mx = ring.reduce((sum, p) => sum + p[0], 0) / count;
  const my = ring.reduce((sum, p) => sum + p[1], 0) / count;
  let xx = 0, xy = 0, yy = 0;
  for (const [x, y] of ring) {
    xx += (x - mx) ** 2;
    xy += (x - mx) * (y - my);
    yy += (y - my) ** 2;
  }
  const angle = Math.atan2(2 * xy, xx - yy) / 2;
  const cos = Math.cos(angle), sin = Math.sin(angle);
  const along = ring.map(([x, y]) => (x - mx) * cos + (y - my) * sin);
  const across = ring.map(([x, y]) => (y - my) * cos - (x - mx) * sin);
  const axis = new Path2D();
  const [low, high] = [Math.min(...along, 0), Math.max(...along, 0)];
  axis.moveTo(mx + low * cos, my + low * sin);
  axis.lineTo(mx + high * cos, my + high * sin);
  const width = 2 * Math.max(...across.map(Math.abs), 0);
  return { outline: pathOf(rings, true), axis, width };
}

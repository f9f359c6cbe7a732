// The map below the agents. Paths are built once, in metres, and drawn through the camera.

const GROUND_COLOURS = {
  light: {
    ground: "#eef0ec", road: "#d3d7dd", kerb: "#a9b0ba", walkway: "#e3ddd0", carpark: "#c8ced6",
    stripe: "#f7f8fa", stop: "#d59c8f", centre: "#8f98a4", laneDivider: "#6d7682",
    roadDivider: "#96650a",
  },
  dark: {
    ground: "#11151a", road: "#2f3743", kerb: "#566271", walkway: "#21272e", carpark: "#28303a",
    stripe: "#5d6979", stop: "#7d4a42", centre: "#4b5766", laneDivider: "#8b97a6",
    roadDivider: "#b98a26",
  },
};

const FADE_M = 10;

class Ground {
  constructor(run) {
    const { mapX, mapY } = run.a;
    const cursor = { at: 0 };
    const layers = {};
    for (const [name, layer] of Object.entries(run.layers)) {
      layers[name] = layer.map((entry) => readRings(entry, mapX, mapY, cursor));
    }
    const joined = (name, close) => pathOf((layers[name] || []).flat(), close);
    this.road = joined("drivable", true);
    this.edges = boxOf((layers.drivable || []).flat());
    this.walkways = joined("walkways", true);
    this.carparks = joined("carparks", true);
    this.stops = joined("stops", true);
    this.roadDividers = joined("road_dividers", false);
    this.laneDividers = joined("lane_dividers", false);
    this.lanes = joined("lanes", false);
    this.chevrons = chevronsOf((layers.lanes || []).flat());
    this.crossings = (layers.crossings || []).map(zebraOf);
  }

  /** Draw through the transform that is set; pixel is the size of a CSS pixel in metres. */
  draw(context, colours, pixel) {
    context.lineJoin = "round";
    context.lineCap = "butt";
    this.fill(context, this.walkways, colours.walkway);
    context.strokeStyle = colours.kerb;
    context.lineWidth = Math.max(0.3, 1.6 * pixel);
    context.stroke(this.road);
    this.fill(context, this.road, colours.road);
    this.fill(context, this.carparks, colours.carpark);
    this.fill(context, this.stops, colours.stop);
    for (const crossing of this.crossings) this.zebra(context, crossing, colours.stripe);
    this.stroke(context, this.laneDividers, colours.laneDivider, Math.max(0.14, pixel), [3, 3]);
    this.stroke(context, this.roadDividers, colours.roadDivider, Math.max(0.18, pixel), []);
  }

  /** The map ends where it was cut: it fades into the ground there. */
  fade(context, colours) {
    if (!this.edges) return;
    const [x0, y0, x1, y1] = this.edges, far = 2000, deep = Math.min(FADE_M, (x1 - x0) / 4, (y1 - y0) / 4);
    const strip = (fromX, fromY, toX, toY, x, y, wide, high) => {
      const shade = context.createLinearGradient(fromX, fromY, toX, toY);
      shade.addColorStop(0, colours.ground);
      shade.addColorStop(1, `${colours.ground}00`);
      context.fillStyle = shade;
      context.fillRect(x, y, wide, high);
    };
    strip(x0, 0, x0 + deep, 0, x0 - far, y0 - far, far + deep, 2 * far);
    strip(x1, 0, x1 - deep, 0, x1 - deep, y0 - far, far + deep, 2 * far);
    strip(0, y0, 0, y0 + deep, x0 - far, y0 - far, 2 * far, far + deep);
    strip(0, y1, 0, y1 - deep, x0 - far, y1 - deep, 2 * far, far + deep);
  }

  drawLanes(context, colours, pixel) {
    this.stroke(context, this.lanes, colours.centre, Math.max(0.1, 0.9 * pixel), [0.5, 1.3]);
    if (pixel < 0.3) this.stroke(context, this.chevrons, colours.centre, Math.max(0.14, pixel), []);
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
    this.stroke(context, crossing.axis, colour, crossing.width, [0.55, 0.55]);
    context.restore();
  }
}

/** Rings of one entry: a list of lengths; the points follow each other in all layers' order. */
function readRings(lengths, mapX, mapY, cursor) {
  return lengths.map((length) => {
    const ring = [];
    for (let i = cursor.at; i < cursor.at + length; i++) ring.push([mapX[i], mapY[i]]);
    cursor.at += length;
    return ring;
  });
}

/** Least and greatest x and y of rings, or null. */
function boxOf(rings) {
  if (!rings.length) return null;
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of rings.flat()) {
    box[0] = Math.min(box[0], x);
    box[1] = Math.min(box[1], y);
    box[2] = Math.max(box[2], x);
    box[3] = Math.max(box[3], y);
  }
  return box;
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
  const path = new Path2D(), gap = 14, size = 0.55;
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

// The view of the map that all panes share, and the gestures that move it.

const SCALE_LIMITS = [0.6, 80]; // pixels a metre

/** Centre in metres, pixels a metre, and the direction of the map that points to the right. */
class Camera {
  x = 0;
  y = 0;
  scale = 7;
  right = 0;

  /** Transform from metres to the pixels of a pane of this size (canvas pixels: ratio a CSS pixel). */
  apply(context, width, height, ratio) {
    const s = this.scale * ratio;
    const cos = Math.cos(this.right) * s, sin = Math.sin(this.right) * s;
    const e = width * ratio / 2 - (this.x * cos + this.y * sin);
    const f = height * ratio / 2 - (this.x * sin - this.y * cos);
    context.setTransform(cos, sin, sin, -cos, e, f);
  }

  toScreen(x, y, width, height) {
    const dx = x - this.x, dy = y - this.y;
    const cos = Math.cos(this.right), sin = Math.sin(this.right);
    return [
      width / 2 + this.scale * (dx * cos + dy * sin),
      height / 2 + this.scale * (dx * sin - dy * cos),
    ];
  }

  toMap(px, py, width, height) {
    const u = (px - width / 2) / this.scale, v = (py - height / 2) / this.scale;
    const cos = Math.cos(this.right), sin = Math.sin(this.right);
    return [this.x + u * cos + v * sin, this.y + u * sin - v * cos];
  }

  pan(dx, dy) {
    const [x, y] = this.toMap(-dx, -dy, 0, 0);
    this.x = x;
    this.y = y;
  }

  /** Zoom by a factor; the point under the pixel stays where it is, or the centre does. */
  zoom(factor, px, py, width, height, keepCentre) {
    const [x, y] = this.toMap(px, py, width, height);
    this.scale = Math.min(Math.max(this.scale * factor, SCALE_LIMITS[0]), SCALE_LIMITS[1]);
    if (keepCentre) return;
    const [newX, newY] = this.toMap(px, py, width, height);
    this.x += x - newX;
    this.y += y - newY;
  }

  /** Show a box [x0, y0, x1, y1] whole. */
  fit(box, width, height) {
    this.right = 0;
    this.x = (box[0] + box[2]) / 2;
    this.y = (box[1] + box[3]) / 2;
    const wide = Math.max(box[2] - box[0], 20), high = Math.max(box[3] - box[1], 20);
    const scale = 0.92 * Math.min(width / wide, height / high);
    this.scale = Math.min(Math.max(scale, SCALE_LIMITS[0]), SCALE_LIMITS[1]);
  }
}

/**
 * Mouse, touch and wheel on a canvas.
 * handlers: zoom(factor, x, y) and, if wanted, drag(dx, dy), tap(x, y).
 */
function listenToGestures(canvas, handlers) {
  const pointers = new Map();
  let moved = 0, spread = 0;

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const distance = () => {
    const [p, q] = [...pointers.values()];
    return Math.hypot(p.x - q.x, p.y - q.y);
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, place(event));
    if (pointers.size === 1) moved = 0;
    if (pointers.size === 2) spread = distance();
  });

  canvas.addEventListener("pointermove", (event) => {
    const now = place(event), before = pointers.get(event.pointerId);
    if (!before) return;
    const dx = now.x - before.x, dy = now.y - before.y;
    pointers.set(event.pointerId, now);
    moved += Math.abs(dx) + Math.abs(dy);
    if (moved < 5) return;
    if (pointers.size === 2) {
      const wide = distance();
      const [p, q] = [...pointers.values()];
      handlers.drag?.(dx / 2, dy / 2);
      if (spread > 0) handlers.zoom(wide / spread, (p.x + q.x) / 2, (p.y + q.y) / 2);
      spread = wide;
    } else handlers.drag?.(dx, dy);
  });

  const release = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    if (event.type !== "pointerup" || moved >= 5 || pointers.size) return;
    const { x, y } = place(event);
    handlers.tap?.(x, y);
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const { x, y } = place(event);
    const lines = event.deltaMode === 1 ? 16 : 1;
    handlers.zoom(Math.exp(-event.deltaY * lines * 0.0016), x, y);
  }, { passive: false });
}

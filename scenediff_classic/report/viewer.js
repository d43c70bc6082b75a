/* The report's 3D view: points with a depth buffer, lines on top, on a plain 2D canvas. */
"use strict";

/* Shows a scene in an element with a canvas and controls; gives a function that draws it anew. */
function showScene(host, scene) {
  const canvas = host.querySelector("canvas");
  const context = canvas.getContext("2d");
  const show = { before: true, after: true, cameras: true, objects: true };
  const FOCAL = 1.25; // of the canvas's shorter side
  const NEAR = 0.02;

  // Vectors
  const add = (a, b, s = 1) => [a[0] + b[0] * s, a[1] + b[1] * s, a[2] + b[2] * s];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [
    a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
  const mean = (list) => list.reduce((s, p) => add(s, p, 1 / list.length), [0, 0, 0]);

  // The cloud's 16-bit steps become floats once
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  function unpack(cloud) {
    const raw = bytes(cloud.xyz);
    const view = new DataView(raw.buffer);
    const xyz = new Float32Array(cloud.count * 3);
    for (let i = 0; i < xyz.length; i++) {
      const axis = i % 3;
      const step = view.getUint16(2 * i, true) / 65535;
      xyz[i] = cloud.low[axis] + step * cloud.span[axis];
    }
    return { xyz, rgb: bytes(cloud.rgb), size: bytes(cloud.size), count: cloud.count };
  }
  const clouds = { before: unpack(scene.clouds.before), after: unpack(scene.clouds.after) };

  // A turntable about the world's up direction
  const up = unit(scene.up);
  const helper = Math.abs(up[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0];
  const east = unit(cross(helper, up));
  const north = cross(up, east);
  let eye;
  function reset() {
    const from = scene.from;
    const flat = [dot(from, east), dot(from, north), dot(from, up)];
    const level = Math.atan2(flat[2], Math.hypot(flat[0], flat[1]));
    eye = {
      target: [0, 0, 0],
      turn: Math.atan2(flat[1], flat[0]),
      tilt: Math.min(Math.max(level, 0.15) + 0.2, 1.2),
      distance: 1.6,
    };
    while (eye.distance < 6 && !allInView()) eye.distance *= 1.05;
  }
  function allInView() {
    const width = Math.max(canvas.clientWidth, 1), height = Math.max(canvas.clientHeight, 1);
    const cam = camera(width, height);
    const ends = [1, -1].flatMap((s) => [east, north].map((axis) => add([0, 0, 0], axis, 0.8 * s)));
    return [...ends, ...scene.cameras.map((c) => c.shape[0])].every((p) => {
      const q = toCamera(cam, p);
      if (q[2] < NEAR) return false;
      const [x, y] = toPixel(cam, q);
      return x > 12 && y > 12 && x < width - 12 && y < height - 12;
    });
  }

  function camera(width, height) {
    const flat = Math.cos(eye.tilt);
    let back = add([0, 0, 0], east, flat * Math.cos(eye.turn));
    back = add(add(back, north, flat * Math.sin(eye.turn)), up, Math.sin(eye.tilt));
    const right = unit(cross(up, back));
    return {
      right, down: cross(right, back), forward: add([0, 0, 0], back, -1),
      position: add(eye.target, back, eye.distance),
      focal: FOCAL * Math.min(width, height), cx: width / 2, cy: height / 2,
    };
  }
  function toCamera(cam, p) {
    const d = add(p, cam.position, -1);
    return [dot(d, cam.right), dot(d, cam.down), dot(d, cam.forward)];
  }
  const toPixel = (cam, q) =>
    [cam.cx + cam.focal * q[0] / q[2], cam.cy + cam.focal * q[1] / q[2]];

  function drawPoints(cam, image, ratio) {
    const { width, height } = image;
    const colour = new Uint32Array(image.data.buffer);
    const depth = new Float32Array(width * height).fill(Infinity);
    const [rx, ry, rz] = cam.right, [dx, dy, dz] = cam.down, [fx, fy, fz] = cam.forward;
    const [px, py, pz] = cam.position;
    for (const video of ["before", "after"]) {
      if (!show[video]) continue;
      const { xyz, rgb, size, count } = clouds[video];
      for (let i = 0; i < 3 * count; i += 3) {
        const x = xyz[i] - px, y = xyz[i + 1] - py, z = xyz[i + 2] - pz;
        const w = fx * x + fy * y + fz * z;
        if (w < NEAR) continue;
        const u = cam.cx + cam.focal * (rx * x + ry * y + rz * z) / w;
        const v = cam.cy + cam.focal * (dx * x + dy * y + dz * z) / w;
        const patch = (size[i / 3] / scene.sizeSteps || 0.008) * cam.focal / w;
        const side = Math.min(Math.max(Math.round(patch), ratio), 16 * ratio);
        const u0 = Math.round(u - side / 2), v0 = Math.round(v - side / 2);
        const left = Math.max(u0, 0), top = Math.max(v0, 0);
        const right = Math.min(u0 + side, width), bottom = Math.min(v0 + side, height);
        const packed = 0xff000000 | (rgb[i + 2] << 16) | (rgb[i + 1] << 8) | rgb[i];
        for (let row = top; row < bottom; row++) {
          for (let at = row * width + left; at < row * width + right; at++) {
            if (w < depth[at]) { depth[at] = w; colour[at] = packed; }
          }
        }
      }
    }
  }

  function line(cam, a, b) {
    let p = toCamera(cam, a), q = toCamera(cam, b);
    if (p[2] < NEAR && q[2] < NEAR) return;
    if (p[2] < NEAR) [p, q] = [q, p];
    if (q[2] < NEAR) q = add(p, add(q, p, -1), (p[2] - NEAR) / (p[2] - q[2]));
    context.moveTo(...toPixel(cam, p));
    context.lineTo(...toPixel(cam, q));
  }
  function stroke(colour, width, dashes, draw) {
    context.beginPath();
    draw();
    context.setLineDash(dashes);
    context.lineWidth = width;
    context.strokeStyle = colour;
    context.stroke();
  }

  function drawCameras(cam, ratio) {
    for (const video of ["before", "after"]) {
      if (!show[video]) continue;
      const mine = scene.cameras.filter((c) => c.video === video);
      stroke(scene.colours[video], 1.6 * ratio, [], () => {
        for (const { shape: [tip, a, b, c, d] } of mine) {
          for (const [p, q] of [[tip, a], [tip, b], [tip, c], [tip, d], [a, b], [b, c], [c, d], [d, a]])
            line(cam, p, q);
        }
      });
      if (!scene.trails[video]) continue;
      stroke(scene.colours[video], 2.4 * ratio, [], () => {
        for (let i = 1; i < mine.length; i++) line(cam, mine[i - 1].shape[0], mine[i].shape[0]);
      });
    }
  }

  function drawObjects(cam, ratio) {
    for (const item of scene.objects) {
      const middles = [];
      for (const video of ["before", "after"]) {
        const box = item.boxes[video];
        if (!box) continue;
        middles.push(mean(box));
        const dashes = item.kind === "moved" && video === "before" ? [5 * ratio, 4 * ratio] : [];
        stroke(item.colour, 2 * ratio, dashes, () => {
          for (let k = 0; k < 8; k++)
            for (const bit of [1, 2, 4]) if (!(k & bit)) line(cam, box[k], box[k | bit]);
        });
      }
      if (middles.length === 2)
        stroke(item.colour, 2.5 * ratio, [], () => line(cam, middles[0], middles[1]));
      const box = item.boxes.after || item.boxes.before;
      if (box) label(cam, top(box), item, ratio);
    }
    context.setLineDash([]);
  }
  function top(box) {
    const middle = mean(box);
    const high = Math.max(...box.map((p) => dot(add(p, middle, -1), up)));
    return add(middle, up, high);
  }
  function label(cam, point, item, ratio) {
    const q = toCamera(cam, point);
    if (q[2] < NEAR) return;
    const [x, under] = toPixel(cam, q);
    const text = `${item.name || item.id} ${item.kind}`;
    context.font = `600 ${13 * ratio}px system-ui, sans-serif`;
    const wide = context.measureText(text).width + 10 * ratio, high = 20 * ratio;
    const y = under - 0.8 * high;
    context.fillStyle = item.colour;
    context.fillRect(x - wide / 2, y - high / 2, wide, high);
    context.fillStyle = "#101014";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(text, x, y);
  }

  let waiting = false;
  function redraw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(draw);
  }
  function draw() {
    waiting = false;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(Math.round(canvas.clientWidth * ratio), 1);
    const height = Math.max(Math.round(canvas.clientHeight * ratio), 1);
    canvas.width = width;
    canvas.height = height;
    const cam = camera(width, height);
    const image = context.createImageData(width, height);
    drawPoints(cam, image, Math.round(ratio));
    context.putImageData(image, 0, 0);
    if (show.cameras) drawCameras(cam, ratio);
    if (show.objects) drawObjects(cam, ratio);
  }

  // Turning, shifting, zooming: mouse, touch and keyboard
  const fingers = new Map();
  let spread = 0;
  function turn(x, y) {
    eye.turn -= x * 0.008;
    eye.tilt = Math.min(Math.max(eye.tilt + y * 0.008, -1.5), 1.5);
  }
  function shift(x, y) {
    const cam = camera(canvas.clientWidth, canvas.clientHeight);
    const step = eye.distance / cam.focal;
    eye.target = add(add(eye.target, cam.right, -x * step), cam.down, -y * step);
  }
  const zoom = (factor) => { eye.distance = Math.min(Math.max(eye.distance * factor, 0.1), 20); };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    spread = 0;
    canvas.focus({ preventScroll: true });
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const x = event.clientX - last[0], y = event.clientY - last[1];
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size === 1) {
      if (event.shiftKey || event.buttons & 6) shift(x, y); else turn(x, y);
    } else {
      const [[ax, ay], [bx, by]] = [...fingers.values()];
      const now = Math.hypot(ax - bx, ay - by);
      if (spread) zoom(spread / Math.max(now, 1));
      spread = now;
      shift(x / 2, y / 2);
    }
    redraw();
  });
  for (const name of ["pointerup", "pointercancel"])
    canvas.addEventListener(name, (event) => { fingers.delete(event.pointerId); spread = 0; });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey) return; // let the page scroll
    event.preventDefault();
    zoom(Math.exp(Math.sign(event.deltaY) * 0.12));
    redraw();
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turn(-12, 0), ArrowRight: () => turn(12, 0),
    ArrowUp: () => turn(0, 12), ArrowDown: () => turn(0, -12),
    "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1.1), 0: reset,
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
    redraw();
  });
  for (const box of host.querySelectorAll("input[data-layer]")) {
    show[box.dataset.layer] = box.checked;
    box.addEventListener("change", () => { show[box.dataset.layer] = box.checked; redraw(); });
  }
  host.querySelector("button").addEventListener("click", () => { reset(); redraw(); });
  reset();
  new ResizeObserver(redraw).observe(canvas);
  redraw();
  return redraw;
}

(function () {
  const host = document.getElementById("viewer");
  const data = document.getElementById("scene");
  if (host && data) showScene(host, JSON.parse(data.textContent));
})();

"use strict";
// 3-D views: drag or arrow keys turn, wheel or + and - zoom, 0 resets. Parallel projection as in the static figure.
// Each kind has a button that hides it.
for (const holder of document.querySelectorAll("[data-scene]")) {
  const scene = JSON.parse(holder.querySelector("script").textContent);
  const still = holder.querySelector("svg, picture, img"), canvas = document.createElement("canvas");
  const pen = canvas.getContext("2d"), start = { turn: scene.turn, tilt: scene.tilt, zoom: 0 };
  let view = { ...start };
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "3-D view; the arrow keys turn it, plus and minus zoom, 0 resets");
  still.classList.add("hidden");
  const legend = document.createElement("div"), hidden = new Set();
  legend.className = "legend";
  const solid = scene.kinds.filter((kind) => !kind.faint);
  const role = (kind) => kind.faint ? "muted" : ["first", "third", "fourth", "second"][solid.indexOf(kind) % 4];
  for (const kind of scene.kinds) {
    const button = document.createElement("button"), mark = document.createElement("span");
    mark.style.background = `var(--${role(kind)})`;
    button.type = "button";
    button.append(mark, kind.kind);
    button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      hidden.delete(kind) || hidden.add(kind);
      button.setAttribute("aria-pressed", String(!hidden.has(kind)));
      draw();
    });
    legend.append(button);
  }
  still.before(legend, canvas);
  holder.querySelector(".turning").classList.remove("hidden");
  const colour = (role) => getComputedStyle(document.documentElement).getPropertyValue("--" + role).trim();
  const axes = () => {
    const [c, s, d, e] = [Math.cos(view.turn), Math.sin(view.turn), Math.cos(view.tilt), Math.sin(view.tilt)];
    return [[-s, c, 0], [-c * e, -s * e, d]];
  };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const tip = (kind, i) => kind.at[i].map((value, k) => value + scene.vectors * (kind.vectors ? kind.vectors[i][k] : 0));
  function roomiest(wide, high) {
    // the first view fills the picture, with room for names; a turned one may be longer, so not by far
    const [right, up] = axes(), one = 0.84 * Math.min(wide, high) / scene.size;
    const ends = scene.kinds.flatMap((kind) => kind.at.flatMap((p, i) => [p, tip(kind, i)]));
    const most = ends.map((p) => Math.max(Math.abs(dot(p, right)) / (wide / 2 - Math.min(64, wide / 8)), Math.abs(dot(p, up)) / (high / 2 - 28)));
    return Math.min(1.6, 1 / (one * most.reduce((a, b) => Math.max(a, b), 1e-12)));
  }
  function named(text, at, all, taken) {
    // on the side away from the nearest other place, else on one that no other name has; without room not at all
    const [x, y] = at, far = ([u, v]) => (Math.hypot(u - x, v - y) || Infinity), long = pen.measureText(text).width;
    const [u, v] = all.reduce((a, b) => (far(b) < far(a) ? b : a), at), [right, down] = [x >= u, y > v];
    for (const [a, b] of [[right, down], [right, !down], [!right, down], [!right, !down]]) {
      const left = Math.max(2, Math.min(canvas.clientWidth - long - 2, a ? x + 7 : x - 7 - long)), base = y + (b ? 15 : -6);
      if (taken.some(([l, m, w]) => left < l + w && l < left + long && Math.abs(m - base) < 12)) continue;
      taken.push([left, base, long]);
      pen.strokeText(text, left, base); pen.fillText(text, left, base);
      return;
    }
  }
  const line = (x, y, u, v) => {
    pen.beginPath(); pen.moveTo(x, y); pen.lineTo(u, v);
    const a = Math.atan2(v - y, u - x), l = Math.min(7, Math.hypot(u - x, v - y) / 2);
    for (const turn of [-0.4, 0.4]) { pen.moveTo(u, v); pen.lineTo(u - l * Math.cos(a + turn), v - l * Math.sin(a + turn)); }
    pen.stroke();
  };
  function draw() {
    const wide = canvas.clientWidth || 600, high = Math.round(wide * 0.7), sharp = window.devicePixelRatio || 1;
    canvas.width = wide * sharp; canvas.height = high * sharp;
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.clearRect(0, 0, wide, high);
    start.zoom ||= view.zoom = roomiest(wide, high);
    const [right, up] = axes(), scale = view.zoom * 0.84 * Math.min(wide, high) / scene.size;
    const flat = (p) => [wide / 2 + scale * dot(p, right), high / 2 - scale * dot(p, up)];
    const places = scene.kinds.map((kind) => kind.at.map(flat)), everything = places.flat();
    const shown = scene.kinds.filter((kind) => !hidden.has(kind)), muted = colour("muted");
    pen.font = "12px system-ui, sans-serif";
    for (const kind of [...shown.filter((one) => one.faint), ...shown.filter((one) => !one.faint)]) {
      const ink = colour(role(kind)), count = kind.at.length, size = Math.min(1, wide / 500);
      if (kind.lines) {
        pen.strokeStyle = ink; pen.lineWidth = kind.faint ? 0.5 : 0.7; pen.globalAlpha = kind.faint ? 0.25 : 1;
        pen.beginPath();
        kind.lines.forEach(([a, b]) => { pen.moveTo(...flat(a)); pen.lineTo(...flat(b)); });
        pen.stroke();
        pen.globalAlpha = 1;
      }
      if (kind.faint) continue;
      kind.at.forEach((p, i) => {
        const [x, y] = flat(p);
        if (kind.covariance) {
          const c = kind.covariance[i], by = (a, b) => dot(a, [dot(c[0], b), dot(c[1], b), dot(c[2], b)]);
          const [xx, xy, yy] = [by(right, right), by(right, up), by(up, up)];
          const mean = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy), f = scale * scene.ellipsoids;
          pen.strokeStyle = muted; pen.lineWidth = 0.7; pen.beginPath();
          pen.ellipse(x, y, f * Math.sqrt(mean + half), f * Math.sqrt(Math.max(mean - half, 0)),
            -Math.atan2(xy, (xx - yy) / 2) / 2, 0, 7);
          pen.stroke();
        }
        pen.strokeStyle = pen.fillStyle = ink; pen.lineWidth = 1.3;
        if (kind.vectors) {
          line(x, y, ...flat(tip(kind, i)));
        }
        pen.beginPath(); pen.arc(x, y, size * (count <= 12 ? 4 : count <= 100 ? 3 : 1.8), 0, 7); pen.fill();
      });
    }
    // the ground about their letters keeps names readable on lines
    pen.fillStyle = colour("ink"); pen.strokeStyle = colour("surface"); pen.lineWidth = 3; pen.lineJoin = "round";
    // the arrows at the lower left keep their room
    const taken = [0, 1, 2, 3, 4, 5].map((k) => [0, high - 32 - 12 * k, 92]), most = 6 + wide * high / 8000;
    for (const [k, row, text] of scene.names) {
      if (taken.length < most && !hidden.has(scene.kinds[k])) named(text, places[k][row], everything, taken);
    }
    pen.strokeStyle = pen.fillStyle = colour("ink"); pen.lineWidth = 1;
    ["x", "y", "z"].forEach((name, k) => {
      const [x, y] = [46, high - 46], u = x + 34 * right[k], v = y - 34 * up[k];
      line(x, y, u, v); pen.fillText(name, x + 44 * right[k] - 3, y - 44 * up[k] + 4);
    });
  }
  const change = (turn, tilt, zoom) => {
    view.turn += turn; view.tilt = Math.max(-1.57, Math.min(1.57, view.tilt + tilt)); view.zoom *= zoom; draw();
  };
  let held = null;
  canvas.addEventListener("pointerdown", (e) => { held = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointerup", () => { held = null; });
  canvas.addEventListener("pointermove", (e) => {
    if (held) { change((held[0] - e.clientX) / 150, (e.clientY - held[1]) / 150, 1); held = [e.clientX, e.clientY]; }
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); change(0, 0, Math.exp(-e.deltaY / 500)); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const step = { ArrowLeft: [0.1, 0, 1], ArrowRight: [-0.1, 0, 1], ArrowUp: [0, 0.1, 1], ArrowDown: [0, -0.1, 1],
      "+": [0, 0, 1.2], "-": [0, 0, 1 / 1.2] }[e.key];
    if (e.key === "0") { view = { ...start }; draw(); }
    else if (step) { e.preventDefault(); change(...step); }
  });
  window.addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
}

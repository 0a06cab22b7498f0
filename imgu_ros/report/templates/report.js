/* SPDX-License-Identifier: Apache-2.0 */
// Plots, frames and readout of a report. What is shown goes through textContent alone: names come from strangers.
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const points = data.x.length;
  if (!points) return;
  const COLORS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8c8c00", "#888888"];
  const DARK_COLORS = ["#56b4e9", "#e69f00", "#2fc79a", "#e39cc4", "#8fd0f5", "#ff8a3d", "#d6d64a", "#aaaaaa"];
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const several = data.targets.length > 1;
  const plots = [];
  let selected = 0;
  let timer = 0;

  function element(name, text, parent) {
    const made = document.createElement(name);
    made.textContent = text;
    parent.append(made);
    return made;
  }

  function written(value) {
    if (value === null || value === undefined) return "–";
    if (value !== 0 && Math.abs(value) < 1e-3) return value.toExponential(2);
    return String(Number(value.toPrecision(4)));
  }

  function runAt(target, point) {
    return data.runs[target].find((run) => run[0] <= point && point <= run[1]);
  }

  function statusAt(target, point) {
    const run = runAt(target, point);
    return run ? data.statuses[run[2]].name : "–";
  }

  // The point whose value is nearest, in a list that rises.
  function nearest(list, value) {
    let best = 0;
    for (let i = 1; i < list.length; i++) if (Math.abs(list[i] - value) < Math.abs(list[best] - value)) best = i;
    return best;
  }

  const frames = data.samples.map((sample) => sample.frame);

  function select(point, sample) {
    selected = Math.max(0, Math.min(points - 1, point));
    const frame = data.frame[selected];
    if (frames.length) {
      const shown = sample === undefined ? nearest(frames, frame) : sample;
      byId("picture").src = "data:image/jpeg;base64," + data.samples[shown].jpeg;
      byId("picture").alt = "frame " + frames[shown];
      byId("slider").value = shown;
      byId("pictured").textContent = frames[shown] === frame ? "" : "(picture: frame " + frames[shown] + ", the nearest)";
    }
    readOut(frame);
    for (const plot of plots) {
      plot.redraw(false, false);
      showSelected(plot);
    }
    for (const view of document.querySelectorAll(".paths svg")) showPlace(view);
  }

  function readOut(frame) {
    const few = data.bin > 1 ? "Frames " + frame + " to " + (frame + Math.ceil(data.bin / 2) - 1) : "Frame " + frame;
    byId("selected").textContent = data.xName === "frame" ? few : few + ", " + written(data.x[selected]) + " s";
    const table = document.createElement("table");
    const row = (name) => {
      const made = element("tr", "", table);
      element("td", name, made).className = "text";
      return made;
    };
    const head = element("tr", "", table);
    element("th", "", head);
    for (const name of data.targets) element("th", name, head);
    const [states, reasons] = [row("Status"), row("Reason")];
    data.targets.forEach((_, target) => {
      const run = runAt(target, selected);
      const chip = element("span", run ? data.statuses[run[2]].name : "–", element("td", "", states));
      if (run) {
        chip.className = "chip";
        chip.style.background = data.statuses[run[2]].color;
      }
      element("td", (run && data.reasons[run[3]]) || "–", reasons);
    });
    if (data.targets.every((_, target) => !(runAt(target, selected) || [])[3])) reasons.remove();
    for (const plot of data.plots) {
      for (const label of new Set(plot.curves.map((curve) => curve.label))) {
        const ofLabel = plot.curves.filter((curve) => curve.label === label);
        const made = row(plot.title + (label ? ", " + label : "") + (plot.unit ? " (" + plot.unit + ")" : ""));
        if (ofLabel[0].target === null) {
          element("td", written(ofLabel[0].values[selected]), made).colSpan = data.targets.length;
          continue;
        }
        data.targets.forEach((_, target) => {
          const curve = ofLabel.find((one) => one.target === target);
          element("td", written(curve && curve.values[selected]), made);
        });
      }
    }
    byId("readout").replaceChildren(table);
  }

  function drawSelection(plot) {
    const at = plot.valToPos(data.x[selected], "x", true);
    const box = plot.bbox;
    if (at < box.left || at > box.left + box.width) return;
    plot.ctx.save();
    plot.ctx.strokeStyle = css("--mark");
    plot.ctx.lineWidth = Math.max(1, devicePixelRatio);
    plot.ctx.setLineDash([]);
    plot.ctx.beginPath();
    plot.ctx.moveTo(at, box.top);
    plot.ctx.lineTo(at, box.top + box.height);
    plot.ctx.stroke();
    plot.ctx.restore();
  }

  // Without a pointer over it a plot says the values of the selected frame.
  function showSelected(plot) {
    if (plot.cursor.left === undefined || plot.cursor.left < 0) plot.setLegend({ idx: selected }, false);
  }

  function zoomAll(min, max) {
    for (const plot of plots) {
      const { min: from, max: to } = plot.scales.x;
      if (from !== min || to !== max) plot.setScale("x", { min, max });
    }
  }

  // About the selected frame, where it is in sight; never beyond the first and the last.
  function zoom(factor) {
    const { min, max } = plots[0].scales.x;
    const [first, last] = [data.x[0], data.x[points - 1]];
    const width = Math.min(Math.max((max - min) * factor, (2 * (last - first)) / points), last - first);
    const at = data.x[selected];
    const middle = min <= at && at <= max ? at : (min + max) / 2;
    const from = Math.min(Math.max(middle - width / 2, first), last - width);
    if (width > 0) zoomAll(from, from + width);
  }

  function axis(more) {
    const lines = { stroke: css("--grid"), width: 1 };
    return { stroke: css("--soft"), font: "12px system-ui, sans-serif", grid: lines, ticks: lines, ...more };
  }

  function options(holder, height, more) {
    return {
      width: Math.max(200, holder.clientWidth),
      height,
      cursor: { sync: { key: "imgu" }, drag: { x: true, y: false }, points: { size: 6 } },
      hooks: {
        draw: [drawSelection],
        setScale: [(plot, key) => key === "x" && plots.includes(plot) && zoomAll(plot.scales.x.min, plot.scales.x.max)],
        setCursor: [showSelected],
        ready: [listen],
      },
      ...more,
    };
  }

  // A click selects; a drag zooms.
  function listen(plot) {
    let pressed = 0;
    plot.over.addEventListener("mousedown", (event) => (pressed = event.clientX));
    plot.over.addEventListener("click", (event) => {
      if (Math.abs(event.clientX - pressed) > 4) return;
      select(plot.posToIdx(event.clientX - plot.over.getBoundingClientRect().left));
    });
  }

  function made(holder, opts, columns) {
    plots.push(new uPlot(opts, columns, holder));
  }

  function strip(holder) {
    const count = data.targets.length;
    const draw = (plot) => {
      data.runs.forEach((runs, target) => {
        const top = plot.valToPos(target + 0.12, "y", true);
        const bottom = plot.valToPos(target + 0.88, "y", true);
        for (const [first, last, status] of runs) {
          const left = plot.valToPos(data.x[first], "x", true);
          const next = last + 1 < points ? data.x[last + 1] : data.x[last];
          plot.ctx.fillStyle = data.statuses[status].color;
          plot.ctx.fillRect(left, top, Math.max(devicePixelRatio, plot.valToPos(next, "x", true) - left), bottom - top);
        }
      });
    };
    const clipped = (plot) => {
      const box = plot.bbox;
      plot.ctx.save();
      plot.ctx.beginPath();
      plot.ctx.rect(box.left, box.top, box.width, box.height);
      plot.ctx.clip();
      draw(plot);
      plot.ctx.restore();
    };
    const opts = options(holder, 40 + 24 * count, {
      scales: { x: { time: false }, y: { range: [count, 0], dir: 1 } },
      axes: [axis({ size: 26 }), axis({ size: 58, splits: () => [], grid: { show: false }, ticks: { show: false } })],
      series: [
        { label: data.xName, value: (_, value) => written(value) },
        ...data.targets.map((name, target) => ({
          label: several ? name : "status",
          paths: () => null,
          points: { show: false },
          value: (plot, _value, _series, point) => (point === null || point === undefined ? "–" : statusAt(target, point)),
        })),
      ],
    });
    opts.hooks.drawAxes = [clipped];
    opts.hooks.draw = [drawSelection];
    made(holder, opts, [data.x, ...data.targets.map(() => data.x.map(() => 0))]);
  }

  function curves(holder, plot) {
    const colors = dark.matches ? DARK_COLORS : COLORS;
    const digits = (_, value) => (value === null || value === undefined ? "–" : written(value) + " " + plot.unit);
    const series = plot.curves.map((curve) => ({
      label: [several && curve.target !== null ? data.targets[curve.target] : "", curve.label].filter(Boolean).join(", ") || plot.title,
      stroke: colors[(curve.target || 0) % colors.length],
      width: 1.5,
      dash: curve.predicted ? [4, 3] : undefined,
      points: { show: points < 60 ? true : undefined, size: 4 },
      value: digits,
    }));
    const opts = options(holder, 140, {
      scales: { x: { time: false }, y: { range: (_, min, max) => (max === null ? [0, 1] : [Math.min(0, min), (max || 1) * 1.05]) } },
      axes: [axis({ size: 26 }), axis({ size: 58 })],
      series: [{ label: data.xName, value: digitsOfX }, ...series],
    });
    made(holder, opts, [data.x, ...plot.curves.map((curve) => curve.values)]);
  }

  function digitsOfX(_, value) {
    return value === null || value === undefined ? "–" : written(value);
  }

  function drawAll() {
    for (const plot of plots.splice(0)) plot.destroy();
    strip(byId("strip"));
    data.plots.forEach((plot, number) => curves(byId("plot-" + number), plot));
  }

  function showPlace(view) {
    const [x, , z] = [0, 1, 2].map((axisNumber) => data.paths[view.dataset.target][axisNumber][selected]);
    const across = data.paths[view.dataset.target][view.dataset.across][selected];
    const dot = view.querySelector(".here");
    dot.style.display = x === null || z === null ? "none" : "";
    if (x === null) return;
    dot.setAttribute("cx", Number(view.dataset.left) + view.dataset.scale * across);
    dot.setAttribute("cy", view.dataset.bottom - view.dataset.scale * z);
  }

  function listenToPath(view) {
    view.addEventListener("click", (event) => {
      const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(view.getScreenCTM().inverse());
      const across = data.paths[view.dataset.target][view.dataset.across];
      const z = data.paths[view.dataset.target][2];
      let best = -1;
      let least = Infinity;
      for (let i = 0; i < points; i++) {
        if (across[i] === null) continue;
        const dx = Number(view.dataset.left) + view.dataset.scale * across[i] - place.x;
        const dy = view.dataset.bottom - view.dataset.scale * z[i] - place.y;
        if (dx * dx + dy * dy < least) [best, least] = [i, dx * dx + dy * dy];
      }
      if (best >= 0) select(best);
    });
  }

  function step(by) {
    if (!frames.length) return;
    const sample = (Number(byId("slider").value) + by + frames.length) % frames.length;
    select(nearest(data.frame, frames[sample]), sample);
  }

  function play() {
    clearInterval(timer);
    timer = timer ? 0 : setInterval(() => step(1), 120);
    byId("play").textContent = timer ? "Stop" : "Play";
  }

  if (frames.length) {
    byId("slider").addEventListener("input", () => step(0));
    byId("before").addEventListener("click", () => step(-1));
    byId("after").addEventListener("click", () => step(1));
    byId("play").addEventListener("click", play);
  }
  byId("closer").addEventListener("click", () => zoom(0.5));
  byId("wider").addEventListener("click", () => zoom(2));
  byId("whole").addEventListener("click", () => zoom(Infinity));
  for (const view of document.querySelectorAll(".paths svg")) listenToPath(view);
  drawAll();
  dark.addEventListener("change", drawAll);
  let width = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth === width) return; // a phone's address bar comes and goes
    width = innerWidth;
    for (const plot of plots) plot.setSize({ width: plot.root.parentElement.clientWidth, height: plot.height });
  });
  select(frames.length ? nearest(data.frame, frames[0]) : 0);
})();

"use strict";
// Shows the view that is embedded in the page: unpacks its surfaces, draws them with Plotly, and follows the controls.
(async () => {
  const view = JSON.parse(document.getElementById("view").textContent);
  const plot = document.getElementById("plot");
  const wait = document.getElementById("wait");
  const at = (name) => document.getElementById(name);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const shown = { object: true, bound: true };
  view.groups.forEach((group) => { shown[group.name] = group.shown; });
  const [right, high] = view.down ? [1, 0] : [0, 1]; // the coordinates of a plane that go along a picture's sides
  let number = 0;

  const raw = async (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  };
  const places = async (packed) => {
    const whole = new Uint16Array(await raw(packed));
    const count = whole.length / view.lower.length;
    return view.lower.map((low, axis) => {
      const found = new Float32Array(count);
      const step = (view.upper[axis] - low) / 65535;
      for (let k = 0; k < count; k += 1) found[k] = low + step * whole[axis * count + k];
      return found;
    });
  };
  const surface = async (packed) => {
    const axes = await places(packed.vertices);
    const faces = new Uint32Array(await raw(packed.faces));
    const count = faces.length / 3;
    return { axes, faces: [0, 1, 2].map((corner) => faces.subarray(corner * count, (corner + 1) * count)) };
  };
  const kept = new Map();
  const once = (key, make) => {
    if (!kept.has(key)) kept.set(key, make());
    return kept.get(key);
  };
  const surfaceOf = (index) => once(`surface ${index}`, () => surface(view.surfaces[index]));
  const pointsOf = (state, name) => once(`points ${state} ${name}`, () => places(view.states[state].points[name]));

  // Where a bound is cut: the limit along the chosen axis, and +1 where what is kept lies below it, the side away from the first look.
  const cut = () => {
    const axis = Number(at("axis").value);
    const share = Number(at("cut").value) / 100;
    const sign = view.eye["xyz"[axis]] >= 0 ? 1 : -1;
    const from = sign > 0 ? view.lower[axis] : view.upper[axis];
    return { axis, sign, whole: share >= 1, limit: from + sign * share * (view.upper[axis] - view.lower[axis]) };
  };
  // The part of a surface on one side of a limit; triangles that cross it are cut.
  const clipped = (whole, { axis, sign, limit }) => {
    const axes = whole.axes.map((values) => Array.from(values));
    const faces = [[], [], []];
    const made = new Map();
    const along = whole.axes[axis];
    const crossing = (a, b) => {
      const key = a < b ? a * along.length + b : b * along.length + a;
      if (!made.has(key)) {
        const share = (limit - along[a]) / (along[b] - along[a]);
        axes.forEach((values) => values.push(values[a] + share * (values[b] - values[a])));
        made.set(key, axes[0].length - 1);
      }
      return made.get(key);
    };
    for (let k = 0; k < whole.faces[0].length; k += 1) {
      const corners = [0, 1, 2].map((corner) => whole.faces[corner][k]);
      const ring = [];
      corners.forEach((a, place) => {
        const b = corners[(place + 1) % 3];
        const kept = [a, b].map((corner) => sign * (along[corner] - limit) <= 0);
        if (kept[0]) ring.push(a);
        if (kept[0] !== kept[1]) ring.push(crossing(a, b));
      });
      for (let corner = 2; corner < ring.length; corner += 1) {
        faces[0].push(ring[0]);
        faces[1].push(ring[corner - 1]);
        faces[2].push(ring[corner]);
      }
    }
    return { axes, faces };
  };

  const mesh = (name, found, colour, opacity) => ({
    type: "mesh3d", name, hoverinfo: "skip", color: colour, opacity, flatshading: false,
    x: found.axes[0], y: found.axes[1], z: found.axes[2], i: found.faces[0], j: found.faces[1], k: found.faces[2],
    lighting: { ambient: 0.5, diffuse: 0.7, specular: 0.15, roughness: 0.6, fresnel: 0.1, vertexnormalsepsilon: 0, facenormalsepsilon: 0 },
    lightposition: { x: -1e4, y: 2e4, z: 2e4 },
  });
  const dots = (group, axes) => {
    const marker = { color: group.colour, size: view.solid ? 2.2 : 4, opacity: 0.85 };
    const trace = { name: group.text, mode: "markers", marker, hoverinfo: "x+y+z", x: axes[right], y: axes[high] };
    return view.solid ? { ...trace, type: "scatter3d", z: axes[2] } : { ...trace, type: "scatter" };
  };

  // The pictures of a plane that are shown, one over the other, as a single one.
  const image = (source) => once(source, async () => {
    const found = new Image();
    found.src = source;
    await found.decode();
    return found;
  });
  const picture = async () => {
    const order = view.within ? ["object", "bound", "missed"] : ["bound", "object", "missed"];
    const names = order.filter((name) => name === "missed" || shown[name]);
    const layers = await Promise.all(names.map((name) => image(view.states[number].pictures[name])));
    const canvas = document.createElement("canvas");
    canvas.width = layers[0].naturalWidth;
    canvas.height = layers[0].naturalHeight;
    layers.forEach((layer) => canvas.getContext("2d").drawImage(layer, 0, 0));
    return canvas.toDataURL();
  };

  const traces = async () => {
    const state = view.states[number];
    const found = [];
    if (view.solid && shown.object) found.push(mesh("object", await surfaceOf(state.object), view.colours.object, 1));
    if (view.solid && shown.bound) {
      const whole = await surfaceOf(state.bound);
      const opacity = Number(at("opacity").value);
      found.push(mesh("bound", cut().whole ? whole : clipped(whole, cut()), view.colours.bound, opacity));
    }
    for (const group of view.groups) {
      if (shown[group.name]) found.push(dots(group, await pointsOf(number, group.name)));
    }
    return found;
  };

  const colours = () => {
    const style = getComputedStyle(document.documentElement);
    const of = (name) => style.getPropertyValue(name).trim();
    return { ink: of("--soft"), line: of("--line"), paper: of("--paper") };
  };
  const layout = async () => {
    const { ink, line, paper } = colours();
    const font = { color: ink, size: 12, family: "system-ui, Arial, sans-serif" };
    const common = {
      margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, font, paper_bgcolor: paper, plot_bgcolor: paper, uirevision: "kept",
    };
    const axis = (k) => ({
      title: { text: view.names[k] }, range: [view.lower[k], view.upper[k]], gridcolor: line, zerolinecolor: line, linecolor: line,
      showbackground: false, showspikes: false, tickfont: { color: ink }, nticks: 6,
    });
    if (view.solid) {
      const up = { x: 0, y: 0, z: 0 };
      up["xyz"[view.up]] = 1;
      return { ...common, scene: { xaxis: axis(0), yaxis: axis(1), zaxis: axis(2), aspectmode: "data", camera: { up, eye: view.eye }, dragmode: "orbit" } };
    }
    const images = [{
      source: await picture(), xref: "x", yref: "y", x: view.lower[right], y: view.down ? view.lower[high] : view.upper[high],
      layer: "below", sizing: "stretch", sizex: view.upper[right] - view.lower[right], sizey: view.upper[high] - view.lower[high],
    }];
    const plane = (k) => ({ ...axis(k), automargin: true, zeroline: false, showgrid: false, ticks: "outside", tickcolor: line });
    const y = { ...plane(high), scaleanchor: "x", scaleratio: view.stretch[high] / view.stretch[right] };
    if (view.down) y.range = [view.upper[high], view.lower[high]];
    return { ...common, margin: { l: 12, r: 12, t: 12, b: 12 }, images, dragmode: "pan", xaxis: plane(right), yaxis: y };
  };
  const buttons = view.solid ? ["toImage", "resetCameraDefault3d"] : ["toImage", "zoomIn2d", "zoomOut2d", "resetScale2d"];
  const config = { responsive: true, displaylogo: false, scrollZoom: true, displayModeBar: true, modeBarButtons: [buttons] };

  const words = () => {
    const state = view.states[number];
    at("value").textContent = state.label;
    at("opaque").textContent = Number(at("opacity").value).toFixed(2);
    at("place").textContent = cut().whole ? "whole" : cut().limit.toPrecision(3);
    at("rates").textContent = `${state.rates}.`;
    at("rates").classList.toggle("wrong", state.fn > 0);
    view.groups.forEach((group) => {
      at(`count ${group.name}`).textContent = state.counts[group.name].toLocaleString("en");
    });
  };

  // One drawing at a time; what changes meanwhile is drawn once it has ended.
  let busy = false;
  let again = false;
  const draw = async () => {
    if (busy) {
      again = true;
      return;
    }
    busy = true;
    do {
      again = false;
      words();
      await Plotly.react(plot, await traces(), await layout(), config);
    } while (again);
    busy = false;
    plot.dataset.state = String(number);
  };

  const layer = (name, text, colour) => {
    const label = document.createElement("label");
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: shown[name], id: `show ${name}` });
    const dot = Object.assign(document.createElement("span"), { className: "dot" });
    dot.style.background = colour;
    const count = Object.assign(document.createElement("span"), { className: "count", id: `count ${name}`, title: "points drawn" });
    label.append(box, dot, text, count);
    box.addEventListener("change", () => { shown[name] = box.checked; draw(); });
    at("layers").append(label);
  };
  layer("object", "the object", view.colours.object);
  layer("bound", view.within ? "certainly inside" : "the bound: maybe", view.colours.bound);
  view.groups.forEach((group) => layer(group.name, group.text, group.colour));
  at("bound").classList.toggle("hidden", !view.solid);
  view.names.forEach((name, k) => at("axis").append(new Option(name, k, k === view.cut, k === view.cut)));
  if (view.states.length > 1) {
    at("states").classList.remove("hidden");
    at("asked").textContent = view.asked === "radius" ? "Within a radius" : "At a time";
    at("state").max = String(view.states.length - 1);
  }
  at("state").addEventListener("input", () => { number = Number(at("state").value); draw(); });
  for (const name of ["opacity", "cut", "axis"]) at(name).addEventListener("input", draw);
  dark.addEventListener("change", draw);
  try {
    await draw();
    wait.remove();
  } catch (error) {
    wait.textContent = `This browser cannot draw the page: ${error.message}`;
    throw error;
  }
})();

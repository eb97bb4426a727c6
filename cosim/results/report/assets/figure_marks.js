// How the traces of a figure are drawn as SVG: lines, points with their errors, bars, the cells of a map, and one contour.
"use strict";
(() => {
  const { finite, shade } = window.hexjetFigures;
  const DASHES = { dash: "7 4", dot: "2 3", dashdot: "7 3 2 3" };

  const symbol = (x, y, marker, colour) => {
    const kind = marker.symbol || "circle", open = kind.endsWith("-open"), fill = marker.color || colour, r = (marker.size || 6) / 2, edge = marker.line || {};
    const stroke = open || kind.includes("thin") ? `stroke="${edge.color || fill}" stroke-width="${edge.width || 1.5}"` : edge.width ? `stroke="${edge.color}" stroke-width="${edge.width}"` : "";
    const paint = `fill="${open || kind.includes("thin") ? "none" : fill}" ${stroke} opacity="${marker.opacity ?? 1}"`;
    const [a, b] = [x.toFixed(1), y.toFixed(1)], shape = kind.replace("-open", "");
    if (shape === "circle") return `<circle cx="${a}" cy="${b}" r="${r}" ${paint}/>`;
    const t = r / 2.6, paths = {
      square: `M${-r} ${-r}H${r}V${r}H${-r}Z`, diamond: `M0 ${-1.25 * r}L${1.25 * r} 0L0 ${1.25 * r}L${-1.25 * r} 0Z`,
      "triangle-up": `M0 ${-1.2 * r}L${1.1 * r} ${0.8 * r}H${-1.1 * r}Z`, "triangle-down": `M0 ${1.2 * r}L${1.1 * r} ${-0.8 * r}H${-1.1 * r}Z`,
      cross: `M${-r} ${-t}H${-t}V${-r}H${t}V${-t}H${r}V${t}H${t}V${r}H${-t}V${t}H${-r}Z`, x: `M${-r} ${-t}H${-t}V${-r}H${t}V${-t}H${r}V${t}H${t}V${r}H${-t}V${t}H${-r}Z`,
      "x-thin": `M${-r} ${-r}L${r} ${r}M${r} ${-r}L${-r} ${r}`,
    };
    return `<path d="${paths[shape] || paths.square}" transform="translate(${a} ${b})${shape === "x" ? " rotate(45)" : ""}" ${paint}/>`;
  };

  const drawTrace = (figure, trace, x, y) => {
    if (trace.type === "bar") return drawBars(figure, trace, x, y);
    if (trace.type === "heatmap") return drawCells(figure, trace, x, y);
    if (trace.type === "contour") return drawContour(trace, x, y);
    const parts = [], { line = {}, marker = {}, mode = "lines" } = trace, colour = line.color || marker.color;
    const points = trace.values.x.map((value, n) => [x.px(value), y.px(trace.values.y[n])]);
    if (mode.includes("lines")) {
      let d = "", pen = false;
      for (const [px, py] of points) {
        if (!Number.isFinite(px) || !Number.isFinite(py)) { pen = false; continue; }
        const [a, b] = [px.toFixed(1), Math.max(-1e5, Math.min(1e5, py)).toFixed(1)];
        d += pen ? (line.shape === "hv" ? `H${a}V${b}` : `L${a} ${b}`) : `M${a} ${b}`;
        pen = true;
      }
      parts.push(`<path d="${d}" stroke="${colour}" stroke-width="${line.width || 1.8}" stroke-dasharray="${DASHES[line.dash] || ""}" opacity="${trace.opacity ?? 1}" stroke-linejoin="round"/>`);
    }
    for (const letter of ["x", "y"]) drawErrors(trace, letter, x, y, points, colour, parts);
    if (mode.includes("markers")) for (const [px, py] of points) if (Number.isFinite(px) && Number.isFinite(py)) parts.push(symbol(px, py, marker, colour));
    return parts.join("");
  };

  const drawErrors = (trace, letter, x, y, points, colour, parts) => {
    const error = trace["error_" + letter];
    if (!error) return;
    const axis = letter === "x" ? x : y;
    trace.values[letter].forEach((value, n) => {
      if (!finite(value)) return;
      const ends = [value - ((error.arrayminus || error.array)[n] || 0), value + (error.array[n] || 0)].map((end) => axis.px(end)), [px, py] = points[n], w = error.width || 2;
      const d = letter === "y" ? `M${px} ${ends[0]}V${ends[1]}M${px - w} ${ends[0]}h${2 * w}M${px - w} ${ends[1]}h${2 * w}` : `M${ends[0]} ${py}H${ends[1]}M${ends[0]} ${py - w}v${2 * w}M${ends[1]} ${py - w}v${2 * w}`;
      if (ends.every(Number.isFinite)) parts.push(`<path d="${d}" stroke="${error.color || colour}" stroke-width="${error.thickness || 1}"/>`);
    });
  };

  // where each bar of a trace is: across [from, to] and along [from, to], px
  const barRectangles = (figure, trace, x, y) => {
    const flat = trace.orientation === "h", [across, along] = flat ? [y, x] : [x, y], stacked = figure.layout.barmode === "stack";
    const beside = stacked ? [trace] : figure.shown.filter((each) => each.type === "bar" && (each.xaxis || "x") === x.id && (each.yaxis || "y") === y.id);
    const wide = 1 - (figure.layout.bargap ?? 0.2), each = wide / beside.length, first = -wide / 2 + each * beside.indexOf(trace);
    return trace.values[flat ? "y" : "x"].map((key, n) => {
      const middle = across.even(key), base = stacked && trace.base ? trace.base[n] : 0, value = trace.values[flat ? "x" : "y"][n];
      return { across: [across.at(middle + first), across.at(middle + first + each)], along: [along.px(base), along.px(base + value)] };
    });
  };

  const drawBars = (figure, trace, x, y) => {
    const flat = trace.orientation === "h", marker = trace.marker || {}, parts = [];
    const boxes = barRectangles(figure, trace, x, y);
    boxes.forEach(({ across, along }, n) => {
      const [a, b, c, d] = [Math.min(...across), Math.max(...across), Math.min(...along), Math.max(...along)], opacity = Array.isArray(marker.opacity) ? marker.opacity[n] : marker.opacity ?? 1;
      if ([a, b, c, d].every(Number.isFinite)) parts.push(flat ? `<rect x="${c}" y="${a}" width="${d - c}" height="${b - a}" fill="${marker.color}" opacity="${opacity}"/>` : `<rect x="${a}" y="${c}" width="${b - a}" height="${d - c}" fill="${marker.color}" opacity="${opacity}"/>`);
    });
    const middles = boxes.map(({ across, along }) => { const half = (across[0] + across[1]) / 2; return flat ? [along[1], half] : [half, along[1]]; });
    for (const letter of ["x", "y"]) drawErrors(trace, letter, x, y, middles, marker.color, parts);
    return parts.join("");
  };

  const drawCells = (figure, trace, x, y) => {
    const [ex, ey] = [trace.edges(x).map((even) => x.at(even)), trace.edges(y).map((even) => y.at(even))];
    const scale = trace.coloraxis ? figure.layout.coloraxis : null;
    const [low, high, colours] = scale ? [scale.cmin, scale.cmax, scale.colorscale] : [trace.zmin ?? 0, trace.zmax ?? 1, trace.colorscale];
    const parts = [];
    trace.z.forEach((row, j) => row.forEach((value, i) => {
      if (!finite(value)) return;
      const [a, b, c, d] = [Math.min(ex[i], ex[i + 1]), Math.max(ex[i], ex[i + 1]), Math.min(ey[j], ey[j + 1]), Math.max(ey[j], ey[j + 1])];
      parts.push(`<rect x="${a.toFixed(2)}" y="${c.toFixed(2)}" width="${(b - a).toFixed(2)}" height="${(d - c).toFixed(2)}" fill="${shade(colours, high > low ? (value - low) / (high - low) : 0)}"/>`);
    }));
    return `<g shape-rendering="crispEdges">${parts.join("")}</g>`;
  };

  // where the values between the middles of cells cross the level
  const drawContour = (trace, x, y) => {
    const level = trace.contours.start, px = trace.values.x.map((value) => x.px(value)), py = trace.values.y.map((value) => y.px(value)), { z } = trace;
    let d = "";
    for (let j = 0; j + 1 < z.length; j++) for (let i = 0; i + 1 < z[j].length; i++) {
      const corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]].map(([a, b]) => [px[a], py[b], z[b][a]]);
      if (!corners.every(([, , value]) => finite(value))) continue;
      const crossed = corners.map((from, n) => [from, corners[(n + 1) % 4]]).filter(([from, to]) => (from[2] < level) !== (to[2] < level)).map(([from, to]) => { const part = (level - from[2]) / (to[2] - from[2]); return [from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1])]; });
      for (let n = 0; n + 1 < crossed.length; n += 2) d += `M${crossed[n].map((value) => value.toFixed(1))}L${crossed[n + 1].map((value) => value.toFixed(1))}`;
    }
    return `<path d="${d}" stroke="${trace.line.color}" stroke-width="${trace.line.width}"/>`;
  };

  Object.assign(window.hexjetFigures, { DASHES, drawTrace, barRectangles });
})();

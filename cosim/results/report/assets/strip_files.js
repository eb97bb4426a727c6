// What a panel of strips is saved as: a picture of its pixels, a drawing, or the numbers that are in sight.
"use strict";
(() => {
  const { pageData, flights, element, style, DASHES } = window.hexjet;

  const nameOf = (panel) => `${pageData.name}-${(panel.title || panel.lines.map((line) => line.column.about.name).join("-") || "panel").toLowerCase().replace(/[^a-z0-9]+/g, "-")}`.slice(0, 80);

  const save = (panel, blob, ending) => {
    const link = element("a", { href: URL.createObjectURL(blob), download: `${nameOf(panel)}.${ending}` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };

  const savePng = (panel) => {
    const source = panel.chart.ctx.canvas, ratio = devicePixelRatio;
    const canvas = element("canvas", { width: source.width, height: source.height + 22 * ratio });
    const ctx = canvas.getContext("2d");
    ctx.fillStyle = style("--card");
    ctx.fillRect(0, 0, canvas.width, canvas.height);
    ctx.drawImage(source, 0, 22 * ratio);
    ctx.font = `${12 * ratio}px sans-serif`;
    ctx.fillStyle = style("--ink");
    let x = 8 * ratio;
    ctx.fillText(panel.head.firstChild.textContent, x, 15 * ratio);
    x += ctx.measureText(panel.head.firstChild.textContent).width + 14 * ratio;
    for (const line of panel.lines) { ctx.fillStyle = line.colour; ctx.fillText(panel.label(line), x, 15 * ratio); x += ctx.measureText(panel.label(line)).width + 12 * ratio; }
    canvas.toBlob((blob) => save(panel, blob, "png"));
  };

  const svgOf = (panel) => {
    const u = panel.chart, r = devicePixelRatio, { left, top, width, height } = u.bbox;
    const box = { x: left / r, y: top / r + 22, w: width / r, h: height / r };
    const text = (value) => String(value).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
    const parts = [`<svg xmlns="http://www.w3.org/2000/svg" width="${u.width}" height="${u.height + 40}" font-family="sans-serif" font-size="11">`,
      `<rect width="100%" height="100%" fill="${style("--card")}"/>`,
      `<clipPath id="c"><rect x="${box.x}" y="${box.y}" width="${box.w}" height="${box.h}"/></clipPath>`];
    let along = 8;
    const write = (value, colour) => { parts.push(`<text x="${along}" y="15" fill="${colour}">${text(value)}</text>`); along += 6.2 * String(value).length + 12; };
    write(panel.head.firstChild.textContent, style("--ink"));
    for (const line of panel.lines) write(panel.label(line), line.colour);
    const X = (value) => (u.valToPos(value, "x", true) / r).toFixed(2), Y = (value) => (u.valToPos(value, "y", true) / r + 22).toFixed(2);
    for (const [n, axis] of u.axes.entries()) {
      const labels = axis._values || [];
      (axis._splits || []).forEach((at, i) => {
        if (labels[i] === null || labels[i] === undefined || labels[i] === "") return;
        parts.push(n === 0
          ? `<line x1="${X(at)}" x2="${X(at)}" y1="${box.y}" y2="${box.y + box.h}" stroke="${style("--grid")}"/><text x="${X(at)}" y="${box.y + box.h + 15}" text-anchor="middle" fill="${style("--dim")}">${text(labels[i])}</text>`
          : `<line y1="${Y(at)}" y2="${Y(at)}" x1="${box.x}" x2="${box.x + box.w}" stroke="${style("--grid")}"/><text x="${box.x - 6}" y="${Number(Y(at)) + 4}" text-anchor="end" fill="${style("--dim")}">${text(labels[i])}</text>`);
      });
    }
    const path = (xs, ys, colour, dash, held) => {
      let d = "", pen = false, before = 0;
      for (let i = 0; i < xs.length; i++) {
        if (ys[i] === null || ys[i] === undefined || !Number.isFinite(ys[i])) { pen = false; continue; }
        if (pen && held) d += `H${X(xs[i])}`;
        d += `${pen ? "L" : "M"}${X(xs[i])} ${Y(ys[i])}`;
        pen = true;
        before = i;
      }
      if (before >= 0 && d) parts.push(`<path clip-path="url(#c)" d="${d}" fill="none" stroke="${colour}" stroke-width="1.4"${dash && dash !== "solid" ? ` stroke-dasharray="${DASHES[dash].join(" ")}"` : ""}/>`);
    };
    if (panel.mode === "cross") for (const track of panel.tracks) path(track.xs, track.ys, track.colour);
    else panel.lines.forEach((line, n) => u.series[n + 1].show && path(u.data[0], u.data[n + 1], line.colour, line.dash, line.held && panel.mode === "time"));
    parts.push(`<text x="${box.x + box.w}" y="${u.height + 34}" text-anchor="end" fill="${style("--dim")}">${panel.mode === "time" ? "time [s]" : ""}</text></svg>`);
    return parts.join("\n");
  };

  const saveSvg = (panel) => save(panel, new Blob([svgOf(panel)], { type: "image/svg+xml" }), "svg");

  const csvOf = (panel) => {
    if (panel.mode === "spectrum") {
      const rows = [["frequency_Hz", ...panel.lines.map((line) => panel.label(line))].join(",")];
      for (let i = 0; i < panel.data[0].length; i++) rows.push(panel.data.map((list) => list[i] === null || list[i] === undefined ? "" : list[i]).join(","));
      return rows.join("\n") + "\n";
    }
    const quoted = (value) => /[",\n]/.test(value) ? `"${value.replace(/"/g, '""')}"` : value;
    const one = flights.length === 1;
    const rows = [["time_s", ...panel.lines.map((line) => quoted(`${line.column.about.name}${one ? "" : ` (${line.flight.label})`}`))].join(",")];
    const base = panel.lines[0];
    const [first, end] = panel.seenRows(base);
    for (let row = first; row < end; row++) {
      const t = base.flight.time(row);
      rows.push([Number(t.toPrecision(12)), ...panel.lines.map((line) => {
        const value = line.column.values[line.flight === base.flight ? row : line.flight.row(t)];
        return value === undefined || Number.isNaN(value) || t > line.flight.end + 1e-9 ? "" : Number(value.toPrecision(9));
      })].join(","));
    }
    return rows.join("\n") + "\n";
  };

  const saveCsv = (panel) => save(panel, new Blob([csvOf(panel)], { type: "text/csv" }), "csv");

  window.hexjet.files = { savePng, saveSvg, saveCsv, svgOf, csvOf };
})();

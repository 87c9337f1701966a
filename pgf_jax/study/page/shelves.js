"use strict";
// Draws the robots' shelves from above, and finds the place of a click. Places are in mm: x into the
// shelf (drawn upwards), y to the left.

const Shelves = (() => {
  const COLOURS = { goal: "#009e73", object: "#c8c8c8", chosen: "#0072b2", target: "#e69f00",
    hand: "#333", path: "#333", wall: "#222" };
  const EDGES = { planning: "#9ab", in_window: "#e69f00", in_line: "#e69f00", served: "#d55e00",
    executing: "#009e73", idle: "#ddd" };
  const FRONT = 60, CAPTION = 40;  // mm in front of the shelf that is drawn; px above it
  const BAR = 5;  // px: height of the bar that says how sure a robot is

  // Cells of all robots; the served one is large, at the left.
  function layout(width, height, robots, served) {
    const cells = [];
    let left = 0;
    if (served !== null || robots.length === 1) {
      const number = served === null ? robots[0].robot : served;
      left = robots.length === 1 ? width : Math.round(width * 0.6);
      cells.push({ robot: number, x: 0, y: 0, w: left, h: height, large: true });
      if (robots.length === 1) return cells;
    }
    const others = robots.filter((one) => one.robot !== served);
    const room = width - left;
    let best = null;
    for (let columns = 1; columns <= others.length; columns++) {
      const rows = Math.ceil(others.length / columns);
      const size = Math.min(room / columns, 1.4 * (height / rows - CAPTION));
      if (best === null || size > best.size) best = { columns, rows, size };
    }
    others.forEach((one, i) => cells.push({ robot: one.robot, large: false,
      x: left + (i % best.columns) * (room / best.columns),
      y: Math.floor(i / best.columns) * (height / best.rows),
      w: room / best.columns, h: height / best.rows }));
    return cells;
  }

  // What is left of a cell for the shelf from above, where it is drawn in perspective, too.
  function perspective(cell, robot) {
    if (!cell.large || !robot.heights) return 0;
    return Math.round(0.42 * (cell.h - CAPTION));
  }

  // How places of a robot's shelf are mapped into its cell.
  function map(cell, robot) {
    const [back, side] = robot.walls;
    const above = CAPTION + perspective(cell, robot);
    const scale = Math.min((cell.w - 12) / (2 * side), (cell.h - above - 8) / (back - FRONT));
    const middle = cell.x + cell.w / 2, bottom = cell.y + cell.h - 4;
    return { scale, place: ([x, y]) => [middle - scale * y, bottom - scale * (x - FRONT)],
      back: (u, v) => [FRONT + (bottom - v) / scale, (middle - u) / scale] };
  }

  function circle(pen, at, radius, fill, edge, width, dash) {
    pen.beginPath();
    pen.arc(at[0], at[1], radius, 0, 2 * Math.PI);
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    if (edge) {
      pen.setLineDash(dash || []);
      pen.strokeStyle = edge; pen.lineWidth = width || 1; pen.stroke();
      pen.setLineDash([]);
    }
  }

  function line(pen, points, colour, width, dash) {
    if (points.length < 2) return;
    pen.beginPath();
    pen.moveTo(...points[0]);
    points.slice(1).forEach((point) => pen.lineTo(...point));
    pen.setLineDash(dash || []);
    pen.strokeStyle = colour; pen.lineWidth = width; pen.stroke();
    pen.setLineDash([]);
  }

  function drawOne(pen, cell, robot, frame) {
    const { scale, place } = map(cell, robot);
    const [back, side] = robot.walls;
    const chosen = cell.large && frame.served === robot.robot ? frame.object : null;
    pen.strokeStyle = EDGES[robot.state] || "#ddd";
    pen.lineWidth = cell.large ? 4 : 3;
    pen.strokeRect(cell.x + 2, cell.y + 2, cell.w - 4, cell.h - 4);
    pen.fillStyle = "#222";
    pen.font = `${cell.large ? 18 : 13}px system-ui, sans-serif`;
    pen.textBaseline = "top";
    const failed = robot.failed ? `, ${robot.failed} failed` : "";
    const left = cell.x + 10, top = cell.y + 8 + ("sure" in robot ? BAR : 0), room = cell.w - 20;
    pen.fillText(`Robot ${robot.robot + 1}: ${robot.words}`, left, top, room);
    pen.fillStyle = "#555";
    pen.fillText(robot.news || `${robot.done} done${failed}`, left, top + (cell.large ? 22 : 15), room);
    if ("sure" in robot) bar(pen, left, cell.y + 6, room, robot.sure);
    if (cell.large && robot.costs) curve(pen, cell, robot.costs);
    line(pen, [[200, side], [back, side], [back, -side], [200, -side]].map(place), COLOURS.wall, 2);
    robot.objects.forEach((at, i) => {
      const goal = i === robot.goal;
      const fill = i === chosen ? COLOURS.chosen : goal ? COLOURS.goal : COLOURS.object;
      circle(pen, place(at), scale * robot.radii[i], fill, "#444", goal ? 3 : 1);
      if (cell.large) {
        pen.fillStyle = i === chosen || goal ? "#fff" : "#222";
        pen.font = "13px system-ui, sans-serif";
        pen.textAlign = "center"; pen.textBaseline = "middle";
        pen.fillText(goal ? "goal" : String(i + 1), ...place(at));
        pen.textAlign = "start"; pen.textBaseline = "top";
      }
    });
    robot.hand.forEach((axis) => line(pen, axis.map(place), COLOURS.hand, Math.max(2, 14 * scale)));
    line(pen, robot.path.map(place), COLOURS.path, 1.5, [5, 4]);
    // The ghost of the push: where the object would come to.
    let ghost = null;
    let push = robot.push;
    if (chosen !== null && frame.target) push = [chosen, 1000 * frame.target[0], 1000 * frame.target[1]];
    if (push && push[0] < robot.objects.length) {
      const from = place(robot.objects[push[0]]), to = place([push[1], push[2]]);
      const colour = frame.problem && chosen !== null ? "#b00020" : COLOURS.target;
      line(pen, [from, to], colour, 3);
      circle(pen, to, scale * robot.radii[push[0]], null, colour, 3, [6, 4]);
      ghost = { object: push[0], place: [push[1], push[2]], colour };
    }
    const high = perspective(cell, robot);
    if (high) {
      const box = { x: cell.x + 8, y: cell.y + CAPTION + 4, w: cell.w - 16, h: high - 8 };
      const look = (i) => (i === chosen ? COLOURS.chosen : i === robot.goal ? COLOURS.goal : COLOURS.object);
      Shelf3D.draw(pen, box, robot, look, ghost);
    }
  }

  // How sure a robot is: the part of a bar that is filled; empty and dashed where it is not known.
  function bar(pen, x, y, w, sure) {
    pen.fillStyle = "#555";
    if (sure !== null) pen.fillRect(x, y, sure * w, BAR);
    pen.setLineDash(sure === null ? [2, 3] : []);
    pen.strokeStyle = "#555"; pen.lineWidth = 1; pen.strokeRect(x + 0.5, y + 0.5, w, BAR);
    pen.setLineDash([]);
  }

  // The cost of the best trajectory so far, on a logarithmic scale, in a corner of the cell.
  function curve(pen, cell, costs) {
    if (costs.length < 2) return;
    const w = 120, h = 60, x = cell.x + cell.w - w - 12, y = cell.y + cell.h - h - 12;
    const logs = costs.map((cost) => Math.log10(Math.max(cost, 1)));
    const top = Math.max(...logs), low = Math.min(...logs), range = Math.max(top - low, 1e-6);
    pen.fillStyle = "rgba(255,255,255,0.85)"; pen.fillRect(x, y, w, h);
    pen.strokeStyle = "#999"; pen.lineWidth = 1; pen.strokeRect(x, y, w, h);
    line(pen, logs.map((log, i) => [x + 4 + (w - 8) * i / (logs.length - 1),
      y + 14 + (h - 18) * (top - log) / range]), "#222", 2);
    pen.fillStyle = "#222"; pen.font = "12px system-ui, sans-serif";
    pen.fillText("cost", x + 4, y + 2);
  }

  function draw(canvas, robots, frame) {
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, canvas.width, canvas.height);
    const cells = layout(canvas.width, canvas.height, robots, frame.served);
    cells.forEach((cell) => {
      const robot = robots.find((one) => one.robot === cell.robot);
      if (!robot) return;
      pen.save();
      pen.beginPath(); pen.rect(cell.x, cell.y, cell.w, cell.h); pen.clip();
      drawOne(pen, cell, robot, frame);
      pen.restore();
    });
    return cells;
  }

  // The robot and the place (m) at a point of the canvas; robot null: beside all shelves.
  function find(cells, robots, u, v) {
    for (const cell of cells) {
      if (u < cell.x || u > cell.x + cell.w || v < cell.y || v > cell.y + cell.h) continue;
      const robot = robots.find((one) => one.robot === cell.robot);
      if (!robot) break;
      const [x, y] = map(cell, robot).back(u, v);
      return { robot: cell.robot, x: x / 1000, y: y / 1000 };
    }
    return { robot: null, x: 0, y: 0 };
  }

  return { draw, find };
})();

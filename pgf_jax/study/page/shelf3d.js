"use strict";
// Draws a shelf in perspective, from in front of it and above. Places are in mm: x into the shelf,
// y to the left, z upwards.

const Shelf3D = (() => {
  const EYE = [-330, 0, 560], AIM = [400, 0, 30], AROUND = 20, HAND = 40;

  const minus = (a, b) => a.map((value, i) => value - b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
    a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((value) => value / Math.hypot(...a));

  const ahead = unit(minus(AIM, EYE)), right = unit(cross(ahead, [0, 0, 1]));
  const up = cross(right, ahead);
  const flat = (point) => {
    const from = minus(point, EYE), far = dot(from, ahead);
    return [dot(from, right) / far, -dot(from, up) / far];
  };

  // Maps points into a box of the canvas, so that the whole shelf is in it.
  function map(box, robot) {
    const [back, side] = robot.walls;
    const corners = [[200, side, 0], [200, -side, 0], [back, side, 0], [back, -side, 0],
      [back, side, 150], [back, -side, 150]].map(flat);
    const us = corners.map((c) => c[0]), vs = corners.map((c) => c[1]);
    const [u0, u1, v0, v1] = [Math.min(...us), Math.max(...us), Math.min(...vs), Math.max(...vs)];
    const scale = Math.min(box.w / (u1 - u0), box.h / (v1 - v0));
    return (point) => {
      const [u, v] = flat(point);
      return [box.x + box.w / 2 + scale * (u - (u0 + u1) / 2),
        box.y + box.h / 2 + scale * (v - (v0 + v1) / 2)];
    };
  }

  function hull(points) {
    const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    const half = (list) => {
      const made = [];
      list.forEach((point) => {
        while (made.length > 1 && turn(made[made.length - 2], made[made.length - 1], point) <= 0) made.pop();
        made.push(point);
      });
      return made.slice(0, -1);
    };
    return [...half(sorted), ...half(sorted.reverse())];
  }

  function polygon(pen, points, fill, edge, dash) {
    pen.beginPath();
    points.forEach((point, i) => (i ? pen.lineTo(...point) : pen.moveTo(...point)));
    pen.closePath();
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    pen.setLineDash(dash || []);
    pen.strokeStyle = edge; pen.lineWidth = dash ? 2.5 : 1; pen.stroke();
    pen.setLineDash([]);
  }

  function ring(at, radius, z) {
    return Array.from({ length: AROUND }, (_, i) => {
      const angle = 2 * Math.PI * i / AROUND;
      return [at[0] + radius * Math.cos(angle), at[1] + radius * Math.sin(angle), z];
    });
  }

  // An upright cylinder: its outline, and its top.
  function cylinder(pen, place, at, radius, height, fill, edge, dash) {
    const low = ring(at, radius, 0).map(place), top = ring(at, radius, height).map(place);
    polygon(pen, hull([...low, ...top]), fill, edge, dash);
    polygon(pen, top, fill, edge, dash);
  }

  // What is drawn: the robot, `look` (number of an object -> its colour), and the ghost of a push:
  // { object, place: [x, y], colour }, or null.
  function draw(pen, box, robot, look, ghost) {
    const place = map(box, robot), [back, side] = robot.walls;
    pen.save();
    pen.beginPath(); pen.rect(box.x, box.y, box.w, box.h); pen.clip();
    const floor = [[200, side, 0], [back, side, 0], [back, -side, 0], [200, -side, 0]];
    polygon(pen, floor.map(place), "#f6f3ee", "#222");
    [[[back, side], [back, -side]], [[200, side], [back, side]], [[200, -side], [back, -side]]]
      .forEach((ends) => polygon(pen, [...ends.map(([x, y]) => [x, y, 0]),
        ...[...ends].reverse().map(([x, y]) => [x, y, 150])].map(place), "rgba(120,120,120,0.12)", "#666"));
    const things = robot.objects.map((at, i) => ({ x: at[0], paint: () =>
      cylinder(pen, place, at, robot.radii[i], robot.heights[i], look(i), "#333") }));
    robot.hand.forEach((axis) => things.push({ x: (axis[0][0] + axis[1][0]) / 2, paint: () => {
      const [from, to] = axis.map(([x, y]) => place([x, y, HAND]));
      pen.beginPath(); pen.moveTo(...from); pen.lineTo(...to);
      pen.strokeStyle = "#333"; pen.lineWidth = 7; pen.lineCap = "round"; pen.stroke();
      pen.lineCap = "butt";
    } }));
    things.sort((a, b) => b.x - a.x).forEach((thing) => thing.paint());  // the farthest first
    if (ghost) {
      cylinder(pen, place, ghost.place, robot.radii[ghost.object], robot.heights[ghost.object], null,
        ghost.colour, [6, 4]);
    }
    pen.restore();
  }

  return { draw };
})();

"use strict";
// The experimenter's page: who is where; participants are added, paused, and let go on.

const key = location.pathname.split("/").pop();
let socket = null;

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/wx/${key}`);
  socket.onmessage = (event) => {
    const message = JSON.parse(event.data);
    if (message.type === "link") {
      document.getElementById("link").textContent = `${location.origin}${message.path} (shown once)`;
    } else if (message.type === "people") show(message.people);
  };
  socket.onclose = () => setTimeout(connect, 2000);
}

function show(people) {
  const rows = people.map((person) => {
    const row = document.createElement("tr");
    const page = person.paused ? "paused" : person.connected ? "there" : "away";
    [person.number + 1, person.step, `${person.done} of ${person.of}`, page].forEach((text) => {
      const cell = document.createElement("td");
      cell.textContent = text;
      row.append(cell);
    });
    const cell = document.createElement("td"), button = document.createElement("button");
    button.textContent = person.paused ? "Go on" : "Pause";
    button.onclick = () => socket.send(JSON.stringify(
      { do: person.paused ? "go_on" : "pause", number: person.number }));
    const end = document.createElement("button");
    end.textContent = "End session";
    end.disabled = !person.running;
    end.onclick = () => {
      if (confirm(`End the session of participant ${person.number + 1}?`))
        socket.send(JSON.stringify({ do: "end", number: person.number }));
    };
    cell.append(button, " ", end);
    row.append(cell);
    return row;
  });
  document.querySelector("#people tbody").replaceChildren(...rows);
}

document.getElementById("add").onclick = () => socket.send(JSON.stringify({ do: "add" }));
connect();

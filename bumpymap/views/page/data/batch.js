"use strict";
const table = document.querySelector("table");
const body = table.tBodies[0];
const heads = [...table.tHead.rows[0].cells];
heads.forEach((head, column) => {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = head.textContent;
  head.replaceChildren(button);
  button.addEventListener("click", () => {
    const turn = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", turn === 1 ? "ascending" : "descending");
    const key = (row) => row.cells[column].dataset.v;
    const numbers = head.className !== "text";
    const rows = [...body.rows].sort((one, two) => {
      const [a, b] = [key(one), key(two)];
      if (a === "" || b === "") return (a === "") - (b === "");
      return turn * (numbers ? a - b : a.localeCompare(b, undefined, { numeric: true }));
    });
    body.append(...rows);
  });
});

const filter = document.querySelector(".filter");
filter.hidden = false;
filter.addEventListener("input", () => {
  const least = Number(filter.querySelector("input").value) / 100;
  const rows = [...body.rows];
  for (const row of rows) row.hidden = least > 0 && !(Number(row.querySelector(".crossed").dataset.v || -1) >= least - 1e-9);
  const shown = rows.filter((row) => !row.hidden).length;
  filter.querySelector("output").textContent = shown < rows.length ? `(${shown} of ${rows.length})` : "";
});

"use strict";
// Two pictures of a scene under one slider; tables sorted by a click on a column's head.
for (const box of document.querySelectorAll(".compare")) {
  const pictures = [...document.querySelectorAll(`#${box.dataset.scene} img[data-cell]`)];
  const find = (cell, kind) => pictures.find((p) => p.dataset.cell === cell && p.dataset.kind === kind);
  const [left, right] = box.querySelectorAll("select.cell");
  const flip = box.querySelector("input.flip");
  const stage = box.querySelector(".stage");
  const [under, over] = stage.querySelectorAll("img");
  const tags = stage.querySelectorAll(".tag");
  const show = () => {
    for (const [select, image, tag] of [[left, over, tags[0]], [right, under, tags[1]]]) {
      const picture = (flip.checked && find(select.value, "flip")) || find(select.value, "png");
      image.src = picture.src;
      image.alt = select.value;
      tag.textContent = select.value + (flip.checked && find(select.value, "flip") ? ", FLIP" : "");
    }
  };
  const slider = stage.querySelector("input");
  slider.addEventListener("input", () => stage.style.setProperty("--at", `${slider.value}%`));
  for (const control of [left, right, flip]) control.addEventListener("change", show);
  show();
  box.hidden = false;
}
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    head.querySelector("button").addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const value = (row) => {
        const cell = row.cells[column];
        return cell.dataset.value === undefined ? cell.textContent : cell.dataset.value === "" ? Infinity : Number(cell.dataset.value);
      };
      const rows = [...table.tBodies[0].rows];
      rows.sort((a, b) => {
        const [x, y] = [value(a), value(b)];
        const order = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y));
        return up ? order : -order;
      });
      table.tBodies[0].append(...rows);
    });
  });
}

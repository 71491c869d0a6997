// Shows a table that is wider than its page as cards, one a row, as on a telephone (site.css).

"use strict";

function markHeads(table) {
  const heads = [...table.querySelectorAll("thead th")].map((head) => head.textContent.trim());
  for (const row of table.tBodies[0]?.rows ?? []) {
    [...row.cells].forEach((cell, place) => {
      if (heads[place]) cell.dataset.head = heads[place];
    });
  }
}

function fitTables() {
  for (const table of document.querySelectorAll("article table.docutils")) {
    table.classList.remove("cards");
    const width = table.parentElement.clientWidth;
    table.classList.toggle("cards", width < 640 && table.offsetWidth > width);
  }
}

document.addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll("article table.docutils").forEach(markHeads);
  fitTables();
  window.addEventListener("resize", fitTables);
});

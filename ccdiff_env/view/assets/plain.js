// Tables that a click sorts.

for (const table of document.querySelectorAll("table.sorts")) {
  // rows that leave their name to the row above keep it when they are sorted
  let name = "";
  const whole = () => {
    for (const row of table.tBodies[0].rows) row.cells[0].textContent.trim() ? name = row.cells[0].innerHTML : row.cells[0].innerHTML = name;
  };
  const valueOf = (row, column) => {
    const text = row.cells[column].textContent.trim(), number = parseFloat(text);
    return Number.isNaN(number) || /^[a-z]/i.test(text) ? text : number;
  };
  table.querySelectorAll("thead th").forEach((head, column) => {
    if (!head.textContent) return;
    const button = document.createElement("button");
    button.textContent = head.textContent;
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") !== "descending" && column > 0
        || head.getAttribute("aria-sort") === "ascending";
      for (const other of table.querySelectorAll("th")) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const body = table.tBodies[0];
      whole();
      const rows = [...body.rows].sort((p, q) => {
        const [a, b] = [valueOf(p, column), valueOf(q, column)];
        const by = typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true });
        return down ? -by : by;
      });
      body.append(...rows);
    });
  });
}

// Cards that menus choose: those with all that is chosen.
const menus = [...document.querySelectorAll(".above select")];
for (const menu of menus)
  menu.addEventListener("change", () => {
    for (const card of document.querySelectorAll("[data-of]")) {
      const of = JSON.parse(card.dataset.of);
      card.hidden = menus.some(({ value }, i) => value && value !== of[i]);
    }
  });

// Paper has no fold to open.
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => { part.open = true; }));

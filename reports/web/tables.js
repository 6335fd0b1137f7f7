"use strict";
// Tables: sorted by a click on a header, filtered by a text, columns hidden.
(() => {
  const { element } = report;

  // The number that a cell begins with, or its lower bound, "≥35.2"; exact is better than any, which is less where the
  // header has a ↓; other text comes last.
  function value(text, header) {
    if (text === "∞") return Infinity;
    if (text === "exact") return header.includes("↓") ? -Infinity : Infinity;
    const found = text.replace(/[,\u202f]/g, "").replace(/^≥/, "").replace("\u2212", "-").match(/^[+-]?\d+(\.\d+)?(e[+-]?\d+)?/);
    return found ? Number(found[0]) : null;
  }

  function compared(a, b, up, header) {
    const [x, y] = [value(a, header), value(b, header)];
    if (x !== null && y !== null) return x === y ? 0 : (x < y ? -1 : 1) * up;
    if (x === null && y === null) return a.localeCompare(b) * up;
    return x === null ? 1 : -1;
  }

  function sorted(table, column, header) {
    const up = header.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    for (const each of table.tHead.rows[0].cells) each.removeAttribute("aria-sort");
    header.setAttribute("aria-sort", up === 1 ? "ascending" : "descending");
    const rows = [...table.tBodies[0].rows];
    rows.sort((a, b) => compared(a.cells[column].textContent, b.cells[column].textContent, up, header.textContent));
    table.tBodies[0].append(...rows);
  }

  function columns(table, headers) {
    const list = element("details", { class: "columns" }, element("summary", {}, "Columns"));
    headers.forEach((header, column) => {
      if (!column) return;
      const box = element("input", { type: "checkbox", change: () => {
        for (const row of table.rows) row.cells[column].hidden = !box.checked;
      } });
      box.checked = true;
      list.append(element("label", {}, box, [...header.childNodes].map((part) => part.textContent).join(" ")));
    });
    return list;
  }

  for (const table of document.querySelectorAll("table")) {
    const headers = [...table.tHead.rows[0].cells], name = table.getAttribute("aria-label");
    const filter = element("input", { type: "search", placeholder: "filter rows", "aria-label": `filter rows: ${name}`,
      input: () => {
        const wanted = filter.value.toLowerCase();
        for (const row of table.tBodies[0].rows) row.hidden = !row.textContent.toLowerCase().includes(wanted);
      } });
    // Where the window cuts a table off, a word says so.
    const scroll = table.closest(".scroll"), more = element("span", { class: "more", hidden: "" }, "more columns: scroll →");
    const tools = element("div", { class: "tools" }, filter, columns(table, headers), more);
    scroll.before(tools);
    const watch = new ResizeObserver(() => { more.hidden = scroll.scrollWidth <= scroll.clientWidth; });
    watch.observe(scroll);
    watch.observe(table);
    headers.forEach((header, column) => {
      const button = element("button", { type: "button", click: () => sorted(table, column, header) });
      button.append(...header.childNodes);
      header.append(button);
    });
  }
})();

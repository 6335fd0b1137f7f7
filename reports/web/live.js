"use strict";
// Live materials: the viewer is built, and its shaders are unpacked, when a button asks for them.
(() => {
  for (const root of document.querySelectorAll("[data-live]")) {
    const button = root.querySelector("button");
    button.addEventListener("click", async () => {
      button.disabled = true;
      button.textContent = "Unpacking …";
      const models = await Promise.all(root.dataset.live.split(" ").map((id) => report.unpacked(id)));
      root.querySelector(".place").append(document.getElementById("viewer").content.cloneNode(true));
      button.remove();
      root.viewer = mountViewer(root.querySelector(".viewer"), { width: report.data.width, models });
    });
  }
})();

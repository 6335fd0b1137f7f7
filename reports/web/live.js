"use strict";
// Live materials: the viewer is built, and its shaders are unpacked, when a button asks for them.
(() => {
  // The slices of a truth, which are stored as a picture, as the floats of a table.
  async function table({ half, white }) {
    const bitmap = await createImageBitmap(new Blob([half], { type: "image/webp" })), { width, height } = bitmap;
    const context = new OffscreenCanvas(width, height).getContext("2d");
    context.drawImage(bitmap, 0, 0);
    const { data } = context.getImageData(0, 0, width, height), row = 4 * report.data.width;
    const floats = new Float32Array(row * Math.ceil(data.length / row));
    for (let i = 0; i < data.length; i++) if (i % 4 < 3) floats[i] = white * (data[i] / 255) ** 2.2;
    return floats;
  }

  for (const root of document.querySelectorAll("[data-live]")) {
    const button = root.querySelector("button");
    button.addEventListener("click", async () => {
      button.disabled = true;
      button.textContent = "Unpacking …";
      const place = root.querySelector(".place");
      try {
        const models = await Promise.all(root.dataset.live.split(" ").map((id) => report.unpacked(id)));
        for (const model of models) if (model.white) model.half = await table(model);
        place.append(document.getElementById("viewer").content.cloneNode(true));
        root.viewer = mountViewer(root.querySelector(".viewer"), { width: report.data.width, models });
        button.remove();
      } catch (error) {
        place.replaceChildren();
        button.textContent = `This browser cannot show the material: ${error.message}`;
      }
    });
  }
})();

"""The live material: a page that draws decoded files by WebGL 2, without a network or a server."""

"""The live material: a page that draws decoded files with WebGL 2, without a network or a server."""

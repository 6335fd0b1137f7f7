"""Programs of decoded materials as shaders: GLSL, HLSL, WGSL and Slang from one generator.

Its shader is one function, `material(uv, wo, wi, footprint)`, which returns RGB, and two textures with the constants
that it looks up. `generator` makes it with the statements of `writer` in the spelling of `dialects`, and for Slang with
those of `cooperative`; `export` writes it for a renderer.
"""

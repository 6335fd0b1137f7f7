"""Programs of decoded materials as shaders: GLSL, HLSL and WGSL from one generator."""

"""Drawing of surfaces and roots for reports, the viewer and exports: meshes, colours, shading, outlines in pictures."""

"""Everything that ``load_shape`` reads: files, arrays and other libraries' meshes."""

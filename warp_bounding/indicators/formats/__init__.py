"""Everything that ``load_indicator`` reads: files, arrays and other libraries' meshes."""

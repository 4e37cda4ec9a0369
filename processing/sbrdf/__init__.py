"""Analysis of a BTF into lobes, shadows, shifts and hidden clusters (Chen et al.: SBRDF+)."""

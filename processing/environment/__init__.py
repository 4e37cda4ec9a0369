"""The light of a place: fish-eye photographs or panoramas to a cubemap of radiance."""

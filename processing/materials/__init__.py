"""From reflectance to materials: spheres, reflectance maps, lobes and residuals."""

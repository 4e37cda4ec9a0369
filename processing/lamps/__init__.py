"""Where lamps are and how strong they are: from their images in a mirror ball, a white plate, or a shaded sphere."""

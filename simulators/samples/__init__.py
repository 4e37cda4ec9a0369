"""What can lie in the holder's opening: reliefs and meshes, and how they are made."""

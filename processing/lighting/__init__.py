"""Relighting of scenes whose bodies move, by cuts of visibility (Iwasaki et al., lighting design)."""

"""The experiments of the thesis: settings, runs and analysis. Scripts are thin programs over them."""

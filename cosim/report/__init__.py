"""Pages: each one self-contained file of HTML, with plots to zoom into; nothing of them comes from a network."""

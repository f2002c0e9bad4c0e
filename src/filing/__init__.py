"""How the files of this project say whose they are, and how they are written."""

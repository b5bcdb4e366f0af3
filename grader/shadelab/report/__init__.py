"""What a student reads of a result: one HTML file with pictures, and a few lines in the terminal."""

"""What is made of a result: report, pictures, comparisons, files for other programs."""

"""Why photographs aren't what the model predicts: candidate causes, each judged by its pattern in the residuals."""

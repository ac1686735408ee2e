"""The command `gradients`: what makes the gradients of predicted photographs."""

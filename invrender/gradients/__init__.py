"""How light, geometry and material make the gradients of a reflected light field [RMB07]."""

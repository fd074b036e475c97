"""What a scene is: geometry, materials, cameras, the files they come from and the samplers that invent them."""

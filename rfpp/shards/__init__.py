"""Storage: scenes, their images and G-buffers as samples of plain WebDataset tars."""

// A page without a 3-D view.
connectCharts();
connectTheme();
document.documentElement.dataset.ready = "2d";

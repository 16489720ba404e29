// Puts the report together: decodes its data, draws the charts, starts the 3D view.

const report = JSON.parse(document.getElementById("report-data").textContent);
await inflateAll(report);
const { trace, charts, stage, events } = report;
const end = trace ? trace.start_s + trace.step_s * (trace.rows - 1) : 0;
const moment = makeMoment(trace ? trace.start_s : 0, end);
if (trace) makeCharts(trace, charts, events, moment);
try {
  await makeStage(stage, trace, moment);
} catch (problem) {
  document.getElementById("stage-problem").textContent = problem.message;
}
moment.to(trace && stage.peak_row !== undefined ? trace.start_s + trace.step_s * stage.peak_row : 0);

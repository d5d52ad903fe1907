/* What does not change while a session lasts, for those who draw it: the logic, the joints, what can be set.
 */
#ifndef TELEDIMOS_APPS_PANEL_ABOUT_H
#define TELEDIMOS_APPS_PANEL_ABOUT_H

#include "apps/panel_internal.h"

/* NULL: out of memory. */
json_t *panel_about_json(const scenario *s, const panel_parameter *list, int count);
/* {phases: [{name, text}], events: [{name, text, order}], ways: [{from, event, to}], faults: [text]}: what
 * td_behaviour_react answers in each phase to each event, asked of that function itself. */
json_t *panel_behaviour_json(void);
/* As foxglove.SceneUpdate: a line, and as metadata duration_s, and of a motion that was checked against a map
 * clearance_m, link, time_s, probability, sigma_probability, verdict. */
json_t *panel_plan_json(const live_plan *plan, const td_robot *robot);

#endif

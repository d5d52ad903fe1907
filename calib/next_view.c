#include "calib/next_view.h"

td_next_view_options td_next_view_options_default(void)
{
    return (td_next_view_options){.gain_that_counts = 0.03, .noise_px = 0.2};
}

td_status td_next_view_find(td_next_view *view, const td_calibration *calibration,
                            const td_observations *observations, const td_next_view_options *options,
                            td_error *error)
{
    (void)view, (void)calibration, (void)observations, (void)options;
    return td_fail(error, TD_ERROR_UNSUPPORTED, "no view can be suggested");
}

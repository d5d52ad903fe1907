#include "sim/stereo_view.h"

td_view_options td_view_options_default(void)
{
    return (td_view_options){
        .samples = 2, .blur_px = 0.6, .vignetting = 0.5, .gain = 1, .read_noise = 1, .shot_noise = 0.02};
}

#include "core/progress.h"

bool td_progress_report(const td_progress *progress, const char *stage, size_t done, size_t total)
{
    if (!progress || !progress->function) return true;
    return progress->function(stage, done, total, progress->user);
}

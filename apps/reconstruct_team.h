/* The processes that make one map: this one alone (reconstruct_alone.c), or the ranks of MPI
 * (reconstruct_mpi.c, the program reconstruct-mpi). Rank 0 owns the map, the folder of products and the
 * terminal. The ranks take turns at measuring the frames; what they find is sent to rank 0, which fuses in
 * the order of the frames, so that the bytes do not depend on how many they are. */
#ifndef TELEDIMOS_APPS_RECONSTRUCT_TEAM_H
#define TELEDIMOS_APPS_RECONSTRUCT_TEAM_H

#include "apps/reconstruct_internal.h"

/* First of all in main, and last. The exit status is that of rank 0. */
bool team_start(td_error *error);
int team_end(int status);
int team_rank(void);
int team_size(void);
int team_neighbours(void); /* of them, those on this machine */

/* Where all must have come to, once: fails in all when one has failed (the sentence names its machine), or
 * when they do not see the same dataset. `first`: the first frame to be measured, from rank 0. */
td_status team_agree(td_status status, const char key[TD_HASH_HEX_SIZE], size_t *first, td_error *error);

/* Rank 0: the frame and what it says, wherever it is measured; as reconstruct_measure. */
td_status team_measure(reconstruct_view *view, reconstruct_job *work, size_t index, td_error *error);
/* Rank 0, when it needs no more frames, for whatever reason. */
void team_dismiss(void);
/* The other ranks: measures and sends its frames from `first` on, until they are done or dismissed. */
td_status team_serve(reconstruct_job *work, size_t first, td_error *error);

#endif

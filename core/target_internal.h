/* A target as a document says it. */
#ifndef TELEDIMOS_CORE_TARGET_INTERNAL_H
#define TELEDIMOS_CORE_TARGET_INTERNAL_H

#include "document.h"
#include "target.h"

/* Reads and checks
 *   {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}
 *   {kind: marks, columns: 7, rows: 5, spacing_m: 0.03, diameter_m: 0.012, polarity: dark}
 *   {kind: marks, diameter_m: 0.012, planes: [{columns: …, rows: …, spacing_m: …, target_from_plane: {q: …,
 * t_m: …}}, …]} polarity: dark, light or any (default). */
td_status td_target_parse(td_target *target, const td_field *field, td_error *error);

#endif

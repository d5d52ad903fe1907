/* A target as a document says it. */
#ifndef TELEDIMOS_CORE_TARGET_INTERNAL_H
#define TELEDIMOS_CORE_TARGET_INTERNAL_H

#include "document.h"
#include "target.h"

#define TARGET_KINDS "chessboard, marks, aprilgrid, tags or charuco"

enum { TARGET_LARGEST_BORDER = 2 }; /* cells */

/* Reads and checks
 *   {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}
 *   {kind: marks, columns: 7, rows: 5, spacing_m: 0.03, diameter_m: 0.012, polarity: dark}
 *   {kind: marks, diameter_m: 0.012, planes: [{columns: …, rows: …, spacing_m: …, target_from_plane: {q: …,
 * t_m: …}}, …]}                                   polarity: dark, light or any (default)
 *   {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088, gap_ratio: 0.3}
 *        instead of the gap: spacing_m: 0.1144; besides: dictionary: tag36h11, border: 2, first_id: 0,
 *        order: upward (Kalibr's) or downward
 *   {kind: charuco, columns: 8, rows: 5, spacing_m: 0.04, tag_size_m: 0.03, dictionary: aruco5x5_100}
 *        besides: first_id: 0, legacy: false
 *   {kind: tags, tags: [{id: 3, size_m: 0.1, target_from_tag: {q: …, t_m: …}}, …]}
 *        besides: dictionary: tag36h11, border: 1; the pose of an only tag may be left out */
td_status td_target_parse(td_target *target, const td_field *field, td_error *error);

#endif

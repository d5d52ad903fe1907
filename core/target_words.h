/* A target as a person types it: "chessboard 9x6 25mm". */
#ifndef TELEDIMOS_CORE_TARGET_WORDS_H
#define TELEDIMOS_CORE_TARGET_WORDS_H

#include <jansson.h>

#include "target.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Understands, in any order after the kind, with lengths in mm, cm, m or in ("25mm", "2.5 cm"):
 *
 *   chessboard 9x6 25mm                        inner corners, side of a square
 *   marks 6x6 30mm diameter 10mm               marks, their spacing
 *   aprilgrid 6x6 tag 88mm gap 0.3             or: spacing 114.4mm; border 1, downward, tag25h9, first 5
 *   charuco 7x4 30mm tag 22mm aruco5x5_100     inner corners, side of a square, of a marker; legacy
 *   tags 3 7 12 tag 100mm                      the numbers of single tags (several need a mapping with poses)
 *
 * or a mapping as dataset.yaml has it, "{kind: chessboard, …}". *mapping (may be NULL) is that mapping, to be
 * freed with json_decref. Errors name the word. */
TD_API td_status td_target_from_words(td_target *target, json_t **mapping, const char *words,
                                      td_error *error);

#ifdef __cplusplus
}
#endif
#endif

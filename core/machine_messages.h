/* What a machine and its master say to each other over a link (link.h): each message is a frame's kind and
 * payload. Decoding takes any bytes: whatever is not exactly one message of its kind is refused, all counts
 * and numbers are bounded, and nothing is allocated: texts and images are lent from the payload.
 *
 * On the wire: numbers with the highest byte first; real: the 8 bytes of an IEEE 754 double, finite; text:
 * u16 size and so many bytes of UTF-8 without control characters; n: u8, the robot's joints.
 *
 *   kind  from     message   payload
 *   1     machine  WELCOME   u16 version, 16 bytes session, u8 operator (1: yours to command), text robot,
 *                            64 hex digits model, real period_s, n, n texts (joints' names)
 *   2     master   TASK      64 hex digits task, 64 model, n, n reals start, real duration_s, n reals end,
 *                            n reals force, u32 size, the task's YAML
 *   3     master   ORDER     u8 td_machine_order
 *   4     master   JOINTS    u8 kind (0 flow, 1 force, 2 rate), n, n reals
 *   5     machine  ANSWER    u8 kind answered (2 TASK, 3 ORDER), u8 order or 0, u8 accepted, text
 *   6     machine  STATE     real time_s, u8 mode, text phase, text fault, 8 hex digits task held or zeros,
 *                            u16 step, u16 steps, 7 reals pose (q: w, x, y, z; t: x, y, z), 6 reals twist, n,
 *                            5 n reals (q, dq, force, pressure, flow), n u8 (1: at a stop), u16 motion (0:
 *                            none yet), real share of its length, u8 phase of a trench (0: none), u8 (1: the
 *                            tool is not held to its path)
 *   7     machine  STOPPED   real time_s, real silent_s, real took_s, u8 joint, real angle, text why
 *   8     machine  IMAGE     real time_s, u8 side, u16 width, u16 height, 7 reals pose, n, n reals q,
 *                            u32 size, JPEG; PNG of a pair that LOOK asked for (on the images' own link)
 *   9     master   LOOK      u16 frame: 0 a pair as it is now, n the n-th that was taken as the machine came
 *   10    master   PLAN      u32 size, text: how the trench of the next TASK is dug, which was simulated so
 *
 * Who sends TASK vouches that he simulated it: from where (start), how long it took, where the joints ended,
 * and the most that each joint's cylinders pushed. */
#ifndef TELEDIMOS_CORE_MACHINE_MESSAGES_H
#define TELEDIMOS_CORE_MACHINE_MESSAGES_H

#include "hash.h"
#include "link.h"
#include "plant.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    TD_MACHINE_VERSION = 2,
    TD_MACHINE_TEXT_SIZE = 512,
    TD_MACHINE_MAX_TASK = 128 << 10, /* bytes of YAML */
    TD_MACHINE_MAX_IMAGE = 8 << 20,
    TD_MACHINE_COMMANDS = 0, /* channels of the link */
    TD_MACHINE_IMAGES = 1
};

typedef enum td_machine_kind {
    TD_MACHINE_WELCOME = 1,
    TD_MACHINE_TASK,
    TD_MACHINE_ORDER,
    TD_MACHINE_JOINTS,
    TD_MACHINE_ANSWER,
    TD_MACHINE_STATE,
    TD_MACHINE_STOPPED,
    TD_MACHINE_IMAGE,
    TD_MACHINE_LOOK,
    TD_MACHINE_PLAN
} td_machine_kind;

typedef enum td_machine_order {
    TD_ORDER_EXECUTE, /* the task that it holds */
    TD_ORDER_STOP,    /* at once, and give up */
    TD_ORDER_PAUSE,
    TD_ORDER_RESUME,
    TD_ORDER_REINIT,
    TD_ORDER_MANUAL, /* joints are commanded one by one */
    TD_ORDER_AUTOMATIC,
    TD_ORDER_COUNT
} td_machine_order;

/* What the machine is about, and where an order or a message leads; all others are refused, and told why. A
 * master who is lost leads from each to FAILED, STOP to REST (FAILED stays), Reinit at rest to REST.
 *
 *   REST      TASK that fits -> CHECKING, MANUAL -> MANUAL (after a task only once REINIT was given)
 *   CHECKING  its own simulation agrees -> HOLDING, does not -> REST
 *   HOLDING   EXECUTE -> WORKING, TASK -> CHECKING
 *   WORKING   the end -> REST, PAUSE -> PAUSED, a fault -> FAILED
 *   PAUSED    RESUME -> WORKING
 *   MANUAL    JOINTS (each holds for three periods), AUTOMATIC -> REST
 *   FAILED    REINIT -> REST */
typedef enum td_machine_mode {
    TD_MODE_REST,     /* stands, and may be commanded */
    TD_MODE_CHECKING, /* simulates a task that it was sent */
    TD_MODE_HOLDING,  /* a task, that it has checked */
    TD_MODE_WORKING,
    TD_MODE_PAUSED,
    TD_MODE_MANUAL,
    TD_MODE_FAILED, /* stopped; only Reinit leads on */
    TD_MODE_COUNT
} td_machine_mode;

typedef struct td_machine_welcome {
    uint16_t version;
    uint8_t session[TD_LINK_SESSION_SIZE]; /* for the hello of the images' link */
    bool is_operator;
    char robot[TD_NAME_SIZE], model[TD_HASH_HEX_SIZE];
    double period_s; /* of the control */
    int joints;
    char joint[TD_ROBOT_MAX_JOINTS][TD_NAME_SIZE];
} td_machine_welcome;

typedef struct td_machine_validation {
    char task[TD_HASH_HEX_SIZE];  /* td_task_hash */
    char model[TD_HASH_HEX_SIZE]; /* of robot and control: as WELCOME has it */
    int joints;
    double start[TD_ROBOT_MAX_JOINTS], end[TD_ROBOT_MAX_JOINTS]; /* rad or m */
    double force[TD_ROBOT_MAX_JOINTS];                           /* N */
    double duration_s;
} td_machine_validation;

typedef struct td_machine_task {
    td_machine_validation validation;
    const char *text; /* lent; not ended by 0 */
    size_t size;
} td_machine_task;

typedef struct td_machine_answer {
    td_machine_kind kind;
    td_machine_order order;
    bool accepted;
    char text[TD_MACHINE_TEXT_SIZE];
} td_machine_answer;

typedef struct td_machine_state_message {
    td_machine_mode mode;
    char phase[TD_MACHINE_TEXT_SIZE], fault[TD_MACHINE_TEXT_SIZE];
    char task[9];    /* the first 8 digits of what it holds; "" */
    int step, steps; /* from 0; of a task under way */
    int joints;
    td_plant_state plant;
    int motion; /* from 0; -1: none yet */
    double share;
    int dig_phase; /* -1: of no trench */
    bool loose;
} td_machine_state_message;

/* A safe stop: after how long a silence it was commanded, how long it took, and the joint that went furthest
 * in it. */
typedef struct td_machine_stopped {
    double time_s, silent_s, took_s, angle; /* rad or m */
    int joint;
    char why[TD_MACHINE_TEXT_SIZE];
} td_machine_stopped;

typedef struct td_machine_image {
    double time_s;
    int side, width, height;
    td_pose site_from_vehicle;
    int joints;
    double q[TD_ROBOT_MAX_JOINTS];
    const uint8_t *jpeg; /* lent */
    size_t size;
} td_machine_image;

typedef struct td_machine_message {
    td_machine_kind kind;
    union {
        td_machine_welcome welcome;
        td_machine_task task;
        td_machine_order order;
        struct {
            int joints;
            td_plant_command command;
        } joints;
        td_machine_answer answer;
        td_machine_state_message state;
        td_machine_stopped stopped;
        td_machine_image image;
        int look;
        struct {
            const char *text; /* lent; not ended by 0 */
            size_t size;
        } plan;
    } as;
} td_machine_message;

/* A payload (free()). What does not fit the message's bounds is refused; texts are cut to theirs. */
TD_API td_status td_machine_encode(uint8_t **payload, size_t *size, const td_machine_message *message,
                                   td_error *error);
/* Fails with TD_ERROR_FORMAT, naming the kind and what is wrong with it. */
TD_API td_status td_machine_decode(td_machine_message *message, uint8_t kind, const void *payload,
                                   size_t size, td_error *error);
/* Encodes and sends. */
TD_API td_status td_machine_send(td_link *link, const td_machine_message *message, bool may_drop,
                                 td_error *error);

/* Waits at most `seconds` for the next message, while the link is polled. *came false: none came. Fails when
 * the link is closed (TD_ERROR_IO, with its reason) or when what came is no message. What is lent stays until
 * the next call. */
TD_API td_status td_machine_wait(td_machine_message *message, bool *came, td_link *link, double seconds,
                                 td_error *error);
TD_API double td_machine_now_s(void); /* of the monotonic clock, as the link's now_s */

TD_API const char *td_machine_order_name(td_machine_order order); /* "execute"; "unknown" */
TD_API const char *td_machine_mode_name(td_machine_mode mode);

#ifdef __cplusplus
}
#endif
#endif

/* Proves that documents are read strictly, that what is written is read back as the same tree to the last
 * bit, in YAML and in JSON, and that the getters name file and field. References: for what a plain scalar is,
 * YAML 1.2.2 section 10.3; for JSON, jansson's own parser; for round trips, the tree itself (thousands of
 * random ones). Trees are compared by bits of their reals, not by ==, so no tolerance is needed. Blind to
 * YAML beyond what libyaml 0.2 reads (a JSON file with UTF-16 pairs written as \u escapes is refused). */
#include "core/document.h"
#include "core/random.h"
#include "tests/check.h"
#include "tests/scratch.h"

static bool same(const json_t *a, const json_t *b)
{
    if (json_typeof(a) != json_typeof(b)) return false;
    if (json_is_real(a)) {
        double x = json_real_value(a), y = json_real_value(b);
        return memcmp(&x, &y, sizeof x) == 0;
    }
    if (json_is_array(a)) {
        if (json_array_size(a) != json_array_size(b)) return false;
        for (size_t i = 0; i < json_array_size(a); i++)
            if (!same(json_array_get(a, i), json_array_get(b, i))) return false;
        return true;
    }
    if (json_is_object(a)) {
        /* The order of the keys too. */
        if (json_object_size(a) != json_object_size(b)) return false;
        void *i = json_object_iter((json_t *)a), *j = json_object_iter((json_t *)b);
        for (; i; i = json_object_iter_next((json_t *)a, i), j = json_object_iter_next((json_t *)b, j))
            if (strcmp(json_object_iter_key(i), json_object_iter_key(j)) != 0 ||
                !same(json_object_iter_value(i), json_object_iter_value(j)))
                return false;
        return true;
    }
    return json_equal(a, b);
}

static json_t *parse(const char *text)
{
    td_error error = {0};
    json_t *root = NULL;
    check_ok(td_document_parse(&root, text, strlen(text), "a.yaml", &error), error);
    return root;
}

static void check_refused(const char *text, const char *words)
{
    td_error error = {0};
    json_t *root = NULL;
    check_fails(td_document_parse(&root, text, strlen(text), "a.yaml", &error), TD_ERROR_FORMAT, error,
                words);
    assert_int_equal(strncmp(error.message, "a.yaml:", 7), 0);
    assert_null(root);
    assert_int_equal(td_document_parse(&root, text, strlen(text), "a.yaml", NULL), TD_ERROR_FORMAT);
}

static void test_scalars(void **state)
{
    (void)state;
    const char *const nulls[] = {"", "~", "null", "Null", "NULL"};
    for (size_t i = 0; i < 5; i++) {
        char text[64];
        snprintf(text, sizeof text, "a: %s", nulls[i]);
        json_t *root = parse(text);
        assert_true(json_is_null(json_object_get(root, "a")));
        json_decref(root);
    }
    json_t *root = parse("{a: true, b: False, c: 0x1F, d: 0o17, e: -12, f: 1e3, g: .5, h: 012}");
    assert_true(json_is_true(json_object_get(root, "a")));
    assert_true(json_is_false(json_object_get(root, "b")));
    assert_int_equal(json_integer_value(json_object_get(root, "c")), 31);
    assert_int_equal(json_integer_value(json_object_get(root, "d")), 15);
    assert_int_equal(json_integer_value(json_object_get(root, "e")), -12);
    assert_true(json_real_value(json_object_get(root, "f")) == 1000);
    assert_true(json_real_value(json_object_get(root, "g")) == 0.5);
    assert_int_equal(json_integer_value(json_object_get(root, "h")), 12);
    json_decref(root);
    const char *const strings[] = {"yes",  "no",     "on",     "1_000",      "1:30",  "nan",
                                   ".nan", ".inf",   "-.Inf",  "left01.jpg", "1.2.3", "tRue",
                                   "0b1",  "\"12\"", "'true'", "\"null\"",   "'~'"};
    for (size_t i = 0; i < sizeof strings / sizeof *strings; i++) {
        char text[64];
        snprintf(text, sizeof text, "a: %s", strings[i]);
        root = parse(text);
        const char *value = json_string_value(json_object_get(root, "a"));
        if (!value) fail_msg("%s is not read as a string", strings[i]);
        size_t quoted = strings[i][0] == '"' || strings[i][0] == '\'';
        assert_int_equal(strncmp(value, strings[i] + quoted, strlen(strings[i]) - 2 * quoted), 0);
        json_decref(root);
    }
}

static void test_layouts(void **state)
{
    (void)state;
    json_t *root =
        parse("# a comment\n---\n1: one\nlist:\n- a\n- {b: [1, 2.5]}   # another\ntext: |\n  two\n  lines\n");
    assert_string_equal(json_string_value(json_object_get(root, "1")), "one");
    json_t *list = json_object_get(root, "list");
    assert_int_equal(json_array_size(list), 2);
    json_t *b = json_object_get(json_array_get(list, 1), "b");
    assert_true(json_is_integer(json_array_get(b, 0)) && json_is_real(json_array_get(b, 1)));
    assert_string_equal(json_string_value(json_object_get(root, "text")), "two\nlines\n");
    json_decref(root);
    root = parse("\xEF\xBB\xBF{\"a\": {\"b\": []},\r\n\t\"c\": \"\\u00e4\\/\"}");
    assert_string_equal(json_string_value(json_object_get(root, "c")), "\xC3\xA4/");
    json_decref(root);
}

static void test_what_is_refused(void **state)
{
    (void)state;
    check_refused("", "is empty");
    check_refused("# nothing\n", "is empty");
    check_refused("---\n", "must be a mapping");
    check_refused("[1, 2]", "must be a mapping");
    check_refused("just words", "must be a mapping");
    check_refused("a: 1\nb: 2\na: 3\n", "a.yaml:3: the key 'a' is given twice");
    check_refused("a: &x 1\n", "anchors and aliases");
    check_refused("a: &x [1]\n", "anchors and aliases");
    check_refused("a: 1\nb: *x\n", "a.yaml:2: anchors and aliases");
    check_refused("&x a: 1\n", "anchors and aliases");
    check_refused("a: !!str 1\n", "tags");
    check_refused("!mine {a: 1}", "tags");
    check_refused("a: ! b\n", "tags");
    check_refused("a: 1\n---\nb: 2\n", "a.yaml:2: a second document");
    check_refused("a: 1\n...\n---\n", "second document");
    check_refused("[a]: 1\n", "a key must be a plain word");
    check_refused("? {a: b}\n: 1\n", "a key must be a plain word");
    check_refused("a: 9223372036854775808\n", "the number 9223372036854775808 is too large");
    check_refused("a: 1\nb: -1e999\n", "a.yaml:2: the number -1e999 is too large");
    check_refused("a: \"\\0\"\n", "null character");
    check_refused("a: [1, 2\n", "is not valid YAML");
    check_refused("a: b: c\n", "a.yaml:1: is not valid YAML");
    check_refused("a: \"\x1b[31m\"\n", "is not text");
    check_refused("a: \xff\xfe\n", "is not text");
    check_refused("\x89PNG\r\n\x1a\n", "is not text");
}

static char *nested(int depth)
{
    char *text = calloc(1, (size_t)depth * 2 + 8);
    strcpy(text, "a: ");
    for (int i = 1; i < depth; i++) strcat(text, "[");
    for (int i = 1; i < depth; i++) strcat(text, "]");
    return text;
}

static void test_bounds(void **state)
{
    (void)state;
    td_error error = {0};
    char *fits = nested(64), *deep = nested(65), *far = nested(4000), *text = NULL;
    json_t *root = parse(fits);
    check_ok(td_document_to_yaml(&text, root, 0, &error), error);
    free(text);
    check_ok(td_document_to_json(&text, root, 0, &error), error);
    free(text);
    json_t *deeper = json_pack("{s:o}", "a", root);
    text = NULL;
    check_fails(td_document_to_yaml(&text, deeper, 0, &error), TD_ERROR_ARGUMENT, error, "deeper than 64");
    check_fails(td_document_to_json(&text, deeper, 0, &error), TD_ERROR_ARGUMENT, error, "deeper than 64");
    assert_null(text);
    json_decref(deeper);
    check_refused(deep, "nested deeper than 64 levels");
    check_refused(far, "nested deeper than 64 levels");
    free(fits);
    free(deep);
    free(far);

    char key[200] = "", line[210];
    memset(key, 'k', 128);
    snprintf(line, sizeof line, "%s: 1", key);
    json_decref(parse(line));
    key[128] = 'k';
    snprintf(line, sizeof line, "%s: 1", key);
    check_refused(line, "longer than 128 bytes");

    size_t size = (16 << 20) + 1;
    char *large = malloc(size);
    memset(large, ' ', size);
    memcpy(large, "a: 1\n", 5);
    check_fails(td_document_parse(&root, large, size, "a.yaml", &error), TD_ERROR_FORMAT, error,
                "larger than");
    check_ok(td_document_parse(&root, large, size - 1, "a.yaml", &error), error);
    json_decref(root);
    memcpy(large, "a: [", 4);
    for (size_t i = 4; i < size; i++) large[i] = "0,"[i % 2];
    check_fails(td_document_parse(&root, large, size - 1, "a.yaml", &error), TD_ERROR_FORMAT, error,
                "more than 1048576 values");
    free(large);
}

static void test_read_from_a_file(void **state)
{
    td_error error = {0};
    json_t *root = NULL;
    char *path = td_path_join(*state, "b.yaml");
    check_ok(td_file_write(path, "a: 1", 4, &error), error);
    check_ok(td_document_read(&root, path, &error), error);
    assert_int_equal(json_integer_value(json_object_get(root, "a")), 1);
    json_decref(root);
    root = NULL;
    check_ok(td_file_write(path, "\n\n a: [", 7, &error), error);
    check_fails(td_document_read(&root, path, &error), TD_ERROR_FORMAT, error, path);
    check_fails(td_document_read(&root, *state, &error), TD_ERROR_IO, error, "is a folder");
    assert_null(root);
    free(path);
}

/* ---- writing ---- */

static void test_yaml_layout(void **state)
{
    (void)state;
    td_error error = {0};
    json_t *root = json_pack("{s:s, s:i, s:f, s:n, s:b, s:[s,s], s:[], s:{}, s:{s:f, s:[f,f]}, "
                             "s:[{s:s,s:[i]},{s:s}], s:[[f,f],[f,i]], s:[[[i]],i,{}]}",
                             "name", "left camera", "count", 3, "rms_px", 0.25, "none", "flag", 1, "words",
                             "a b", "yes", "empty", "nothing", "pose", "w", 1.0, "t_m", 0.5, -1e-9, "cameras",
                             "name", "left", "n", 4, "name", "12", "matrix", 1.0, 2.0, 3.0, 4, "odd", 7, 8);
    assert_non_null(root);
    char *text = NULL;
    check_ok(td_document_to_yaml(&text, root, 0, &error), error);
    assert_string_equal(text, "name: left camera\n"
                              "count: 3\n"
                              "rms_px: 0.25\n"
                              "none: null\n"
                              "flag: true\n"
                              "words: [a b, \"yes\"]\n"
                              "empty: []\n"
                              "nothing: {}\n"
                              "pose:\n"
                              "  w: 1.0\n"
                              "  t_m: [0.5, -1.0e-09]\n"
                              "cameras:\n"
                              "  - name: left\n"
                              "    n: [4]\n"
                              "  - name: \"12\"\n"
                              "matrix:\n"
                              "  - [1.0, 2.0]\n"
                              "  - [3.0, 4]\n"
                              "odd:\n"
                              "  -\n"
                              "    - [7]\n"
                              "  - 8\n"
                              "  - {}\n");
    free(text);
    check_ok(td_document_to_json(&text, root, 0, &error), error);
    assert_non_null(strstr(text, "\n  \"matrix\": [\n    [1.0, 2.0],\n    [3.0, 4]\n  ],\n"));
    assert_non_null(
        strstr(text, "\n  \"cameras\": [\n    {\n      \"name\": \"left\",\n      \"n\": [4]\n    },\n"));
    free(text);
    json_decref(root);
}

/* Words that other readers, of YAML 1.1, take for booleans, and texts that begin like numbers or dates. */
static void test_quotes(void **state)
{
    (void)state;
    td_error error = {0};
    const char *const quoted[] = {"Yes",   "no",  "ON", "off", "1_000", "2024-01-05",
                                  "12:30", "0b1", "-",  "",    "a: b",  "a #b"};
    const char *const plain[] = {"left camera", "left01.jpg", "/data/set", "offset", "(a/b)", "y", "a - b"};
    for (size_t i = 0; i < sizeof quoted / sizeof *quoted; i++) {
        char expected[64], *text = NULL;
        json_t *root = json_pack("{s:s}", "a", quoted[i]);
        check_ok(td_document_to_yaml(&text, root, 0, &error), error);
        snprintf(expected, sizeof expected, "a: \"%s\"\n", quoted[i]);
        assert_string_equal(text, expected);
        free(text);
        json_decref(root);
    }
    for (size_t i = 0; i < sizeof plain / sizeof *plain; i++) {
        char expected[64], *text = NULL;
        json_t *root = json_pack("{s:s}", "a", plain[i]);
        check_ok(td_document_to_yaml(&text, root, 0, &error), error);
        snprintf(expected, sizeof expected, "a: %s\n", plain[i]);
        assert_string_equal(text, expected);
        free(text);
        json_decref(root);
    }
}

static void test_digits(void **state)
{
    (void)state;
    td_error error = {0};
    json_t *root = json_pack("{s:f, s:i}", "a", 2.0 / 3, "b", 123456);
    char *text = NULL;
    check_ok(td_document_to_yaml(&text, root, 4, &error), error);
    assert_string_equal(text, "a: 0.6667\nb: 123456\n");
    free(text);
    text = NULL;
    check_fails(td_document_to_yaml(&text, root, 18, &error), TD_ERROR_ARGUMENT, error, "digits: is 18");
    check_fails(td_document_to_json(&text, root, -1, &error), TD_ERROR_ARGUMENT, error, "digits: is -1");
    json_t *array = json_array();
    check_fails(td_document_to_json(&text, array, 0, &error), TD_ERROR_ARGUMENT, error, "must be a mapping");
    assert_null(text);
    json_decref(array);
    json_decref(root);
}

static void test_what_cannot_be_written(void **state)
{
    (void)state;
    td_error error = {0};
    char *text = NULL, key[200] = "";
    json_t *root = json_object();
    json_object_set_new(root, "a", json_stringn("x\0y", 3));
    check_fails(td_document_to_yaml(&text, root, 0, &error), TD_ERROR_ARGUMENT, error, "null character");
    json_object_clear(root);
    memset(key, 'k', 129);
    json_object_set_new(root, key, json_null());
    check_fails(td_document_to_json(&text, root, 0, &error), TD_ERROR_ARGUMENT, error, "longer than 128");
    assert_null(text);
    json_decref(root);
}

static void check_round_trip(const json_t *root)
{
    td_error error = {0};
    for (int json = 0; json < 2; json++) {
        char *text = NULL;
        if (json)
            check_ok(td_document_to_json(&text, root, 0, &error), error);
        else
            check_ok(td_document_to_yaml(&text, root, 0, &error), error);
        json_t *back = NULL;
        if (td_document_parse(&back, text, strlen(text), "t", &error) != TD_OK)
            fail_msg("%s:\n%s", error.message, text);
        if (!same(root, back)) fail_msg("another tree came back from:\n%s", text);
        json_decref(back);
        if (json) {
            json_error_t why;
            back = json_loads(text, JSON_REJECT_DUPLICATES, &why);
            if (!back) fail_msg("%s in:\n%s", why.text, text);
            assert_true(same(root, back));
            json_decref(back);
        }
        free(text);
    }
}

static const char *const awkward[] = {"",
                                      " ",
                                      "a ",
                                      " a",
                                      "~",
                                      "null",
                                      "NULL",
                                      "true",
                                      "False",
                                      "yes",
                                      "No",
                                      "oFF",
                                      "on",
                                      "1",
                                      "-1",
                                      "+1",
                                      "1.5",
                                      ".5",
                                      "1e5",
                                      "0x1F",
                                      "0o7",
                                      ".inf",
                                      "-.INF",
                                      ".nan",
                                      "1_000",
                                      "1:30",
                                      "2024-01-05",
                                      "-",
                                      "- a",
                                      "--- a",
                                      "...",
                                      "?",
                                      "? a",
                                      ":",
                                      "a: b",
                                      "a:",
                                      ":a",
                                      "a #b",
                                      "#a",
                                      "&a",
                                      "*a",
                                      "!a",
                                      "|",
                                      ">",
                                      "%a",
                                      "@a",
                                      "`a",
                                      "[a",
                                      "a]",
                                      "{a",
                                      "a}",
                                      "a,b",
                                      "'a'",
                                      "\"a\"",
                                      "a\"b",
                                      "a\\b",
                                      "a\nb",
                                      "a\r\nb",
                                      "\t",
                                      "a\tb",
                                      "\x01",
                                      "\x1b[0m",
                                      "\x7f",
                                      "\xC2\x85",
                                      "\xC2\xA0",
                                      "\xE2\x80\xA8",
                                      "\xE2\x80\xA9",
                                      "\xEF\xBB\xBF",
                                      "\xEF\xBF\xBE",
                                      "\xEF\xBF\xBF",
                                      "\xC3\xA4\xC3\xB6",
                                      "\xF0\x9F\x98\x80",
                                      "\xED\x9F\xBF",
                                      "<<",
                                      "=",
                                      "a=b",
                                      "y",
                                      "n",
                                      "(a) b-c/d_e;f=g.h+i",
                                      "nullable",
                                      "trueish",
                                      "a  b",
                                      "\n",
                                      "\n\n a",
                                      "a\n",
                                      "C:\\x"};

static void test_awkward_texts(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof awkward / sizeof *awkward; i++) {
        json_t *root =
            json_pack("{s:s, s:[s,s], s:{s:s}, s:[{s:s}]}", awkward[i], awkward[i], "list", awkward[i],
                      awkward[i], "map", awkward[i], awkward[i], "maps", awkward[i], awkward[i]);
        assert_non_null(root);
        check_round_trip(root);
        json_decref(root);
    }
    /* Long ones: libyaml looks 1024 characters ahead for a key. */
    char *text = malloc(100001), key[129];
    for (size_t length = 1000; length <= 100000; length *= 10) {
        memset(text, 'x', length);
        text[length] = 0;
        for (size_t i = 7; i < length; i += 8) text[i] = ' ';
        text[length - 1] = 'x';
        json_t *root = json_pack("{s:s, s:[s], s:[{s:s}], s:[[s], [s,s]]}", "a", text, "b", text, "c", "d",
                                 text, "e", text, text, text);
        check_round_trip(root);
        json_decref(root);
    }
    memset(key, 1, 128);
    key[128] = 0;
    json_t *root = json_pack("{s:{s:[{s:i}]}}", key, key, key, 1);
    check_round_trip(root);
    json_decref(root);
    free(text);
}

static json_t *random_text(td_random *random)
{
    if (td_random_below(random, 3) == 0)
        return json_string(awkward[td_random_below(random, sizeof awkward / sizeof *awkward)]);
    char text[24];
    size_t length = td_random_below(random, sizeof text - 1);
    for (size_t i = 0; i < length; i++) text[i] = (char)(1 + td_random_below(random, 127));
    text[length] = 0;
    return json_string(text);
}

static json_t *random_real(td_random *random)
{
    for (;;) {
        uint64_t bits = (uint64_t)td_random_u32(random) << 32 | td_random_u32(random);
        double value;
        memcpy(&value, &bits, sizeof value);
        if (isfinite(value)) return json_real(value);
    }
}

static json_t *random_tree(td_random *random, int depth)
{
    uint32_t kind = td_random_below(random, depth > 0 ? 10 : 6);
    if (kind == 0) return json_null();
    if (kind == 1) return json_boolean(td_random_below(random, 2));
    if (kind == 2)
        return json_integer((json_int_t)((uint64_t)td_random_u32(random) << 32 | td_random_u32(random)));
    if (kind == 3) return random_real(random);
    if (kind == 4) return json_real(td_random_normal(random));
    if (kind == 5) return random_text(random);
    uint32_t size = td_random_below(random, 5);
    json_t *made = kind < 8 ? json_array() : json_object();
    for (uint32_t i = 0; i < size; i++) {
        json_t *child = random_tree(random, depth - 1);
        if (kind < 8)
            json_array_append_new(made, child);
        else {
            json_t *key = random_text(random);
            json_object_set_new(made, json_string_value(key), child);
            json_decref(key);
        }
    }
    return made;
}

static void test_random_trees_come_back(void **state)
{
    (void)state;
    td_random random = td_random_seed(3, 7);
    size_t large = 0;
    for (int i = 0; i < 4000; i++) {
        json_t *root = json_object(), *tree = random_tree(&random, 6);
        json_object_set_new(root, "tree", tree);
        large += json_is_object(tree) && json_object_size(tree) > 2;
        check_round_trip(root);
        json_decref(root);
    }
    assert_true(large > 100);
}

/* ---- getters ---- */

static json_t *field_root;

static int fields_setup(void **state)
{
    (void)state;
    td_error error = {0};
    const char *text =
        "a: {b: {c: 1.5, i: 7, big: 3000000000, s: word, n: null, t: true, nan: .nan, date: 12}}\n"
        "list: [1, 2, x]\nreals: [1, 2.5]\nwidth: 5\n\"odd\\ekey\": 1\n"
        "pose: {q: [1, 0, 0, 0], t_m: [1, 2, 3]}\n"
        "long: {q: [1.0000005, 0, 0, 0], t_m: [0, 0, 0]}\n"
        "bent: {q: [1, 0.01, 0, 0], t_m: [0, 0, 0]}\n"
        "euler: {q: [1, 0, 0, 0], t_m: [0, 0, 0], rpy: [0, 0, 0]}\n"
        "zero: {q: [0, 0, 0, 0], t_m: [0, 0, 0]}\n";
    return td_document_parse(&field_root, text, strlen(text), "f.yaml", &error) == TD_OK ? 0 : -1;
}

static int fields_teardown(void **state)
{
    (void)state;
    json_decref(field_root);
    return 0;
}

static void test_getters(void **state)
{
    (void)state;
    td_error error = {0};
    td_field root = {NULL, "f.yaml", field_root}, a = td_field_get(&root, "a"), b = td_field_get(&a, "b");
    td_field c = td_field_get(&b, "c"), i = td_field_get(&b, "i"), s = td_field_get(&b, "s"),
             t = td_field_get(&b, "t");
    double real = 0, reals[2];
    int integer = 0;
    bool flag = false;
    const char *text = NULL;
    size_t count = 0;
    check_ok(td_field_real(&real, &c, 1.5, 1.5, &error), error);
    assert_true(real == 1.5);
    check_ok(td_field_real(&real, &i, -INFINITY, INFINITY, &error), error);
    assert_true(real == 7);
    check_ok(td_field_int(&integer, &i, 7, 7, &error), error);
    assert_int_equal(integer, 7);
    check_ok(td_field_string(&text, &s, &error), error);
    assert_string_equal(text, "word");
    check_ok(td_field_bool(&flag, &t, &error), error);
    assert_true(flag);
    td_field list = td_field_get(&root, "reals");
    check_ok(td_field_reals(reals, 2, &list, 0, 3, &error), error);
    assert_true(reals[0] == 1 && reals[1] == 2.5);
    check_ok(td_field_count(&count, &list, 1, 2, &error), error);
    assert_int_equal(count, 2);
}

static void test_getters_refuse(void **state)
{
    (void)state;
    td_error error = {0};
    td_field root = {NULL, "f.yaml", field_root}, a = td_field_get(&root, "a"), b = td_field_get(&a, "b");
    double real = -7, reals[3];
    int integer = -7;
    bool flag = false;
    const char *text = NULL;
    size_t count = 0;
    td_field f = td_field_get(&b, "gone");
    check_fails(td_field_real(&real, &f, 0, 1, &error), TD_ERROR_FORMAT, error,
                "f.yaml: a.b.gone: is missing; must be a finite number");
    check_fails(td_field_string(&text, &f, &error), TD_ERROR_FORMAT, error,
                "f.yaml: a.b.gone: is missing; must be a text");
    check_fails(td_field_bool(&flag, &f, &error), TD_ERROR_FORMAT, error,
                "is missing; must be true or false");
    check_fails(td_field_int(&integer, &f, 0, 1, &error), TD_ERROR_FORMAT, error,
                "is missing; must be a whole number");
    td_field below = td_field_get(&f, "below"); /* absent below absent */
    check_fails(td_field_reals(reals, 3, &below, 0, 1, &error), TD_ERROR_FORMAT, error,
                "a.b.gone.below: is missing; must be a list");
    f = td_field_get(&b, "s");
    check_fails(td_field_real(&real, &f, 0, 1, &error), TD_ERROR_FORMAT, error,
                "a.b.s: must be a finite number, but is the text 'word'");
    f = td_field_get(&b, "nan");
    check_fails(td_field_real(&real, &f, 0, 1, &error), TD_ERROR_FORMAT, error,
                "a.b.nan: must be a finite number, but is the text '.nan'");
    f = td_field_get(&b, "n");
    check_fails(td_field_int(&integer, &f, 0, 1, &error), TD_ERROR_FORMAT, error,
                "a.b.n: must be a whole number, but is null");
    f = td_field_get(&b, "c");
    check_fails(td_field_int(&integer, &f, 0, 9, &error), TD_ERROR_FORMAT, error,
                "must be a whole number, but is 1.5");
    check_fails(td_field_real(&real, &f, 2, 3, &error), TD_ERROR_FORMAT, error,
                "a.b.c: is 1.5, but must lie between 2.0 and 3.0");
    check_fails(td_field_real(&real, &f, 2, INFINITY, &error), TD_ERROR_FORMAT, error,
                "must be at least 2.0");
    check_fails(td_field_real(&real, &f, -INFINITY, 1, &error), TD_ERROR_FORMAT, error,
                "must be at most 1.0");
    check_fails(td_field_bool(&flag, &f, &error), TD_ERROR_FORMAT, error,
                "must be true or false, but is 1.5");
    f = td_field_get(&b, "big");
    check_fails(td_field_int(&integer, &f, 0, INT32_MAX, &error), TD_ERROR_FORMAT, error,
                "is 3000000000, but must lie between 0 and 2147483647");
    f = td_field_get(&b, "date");
    check_fails(td_field_string(&text, &f, &error), TD_ERROR_FORMAT, error,
                "is the number 12; put it in quotes");
    f = td_field_get(&root, "list");
    check_fails(td_field_reals(reals, 3, &f, 0, 9, &error), TD_ERROR_FORMAT, error,
                "f.yaml: list[2]: must be a finite number");
    check_fails(td_field_reals(reals, 2, &f, 0, 9, &error), TD_ERROR_FORMAT, error,
                "list: must have 2 elements, but has 3");
    check_fails(td_field_count(&count, &f, 4, 5, &error), TD_ERROR_FORMAT, error,
                "must have 4 to 5 elements, but has 3");
    check_fails(td_field_real(&real, &a, 0, 1, &error), TD_ERROR_FORMAT, error, "but is a mapping");
    check_fails(td_field_fail(&root, &error, "%d things", 3), TD_ERROR_FORMAT, error, "f.yaml: 3 things");
    assert_int_equal(td_field_real(&real, &f, 0, 1, NULL), TD_ERROR_FORMAT);
    assert_true(real == -7 && integer == -7 && !text && !flag && count == 0);
}

static void test_keys_and_suggestions(void **state)
{
    (void)state;
    td_error error = {0};
    const struct {
        const char *key, *words;
    } row[] = {{"widht", "did you mean 'width'?"},
               {"Width", "did you mean 'width'?"},
               {"hight", "did you mean 'height'?"},
               {"spacing", "did you mean 'spacing_m'?"},
               {"tim", "did you mean 'tim_s'?"},
               {"spacing_mm", "did you mean 'spacing_m'?"},
               {"space", "known here are"},
               {"s", "known here are"},
               {"edn", "did you mean 'end'?"},
               {"kind", "known here are width, height, spacing_m, end, tim_s"},
               {"x", "known here are"},
               {"", "known here are"},
               {"a\x1b[31mb", "unknown key 'a?[31mb'"}};
    static const char *const keys[] = {"width", "height", "spacing_m", "end", "tim_s", NULL};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        json_t *object = json_pack("{s:i, s:i}", "width", 1, row[i].key, 2);
        td_field root = {NULL, "f.yaml", object}, field = {&root, "part", object};
        check_fails(td_field_check_keys(&field, keys, &error), TD_ERROR_FORMAT, error, row[i].words);
        assert_int_equal(strncmp(error.message, "f.yaml: part: unknown key '", 27), 0);
        json_decref(object);
    }
    char longest[129];
    memset(longest, 'w', 128);
    longest[128] = 0;
    json_t *object = json_pack("{s:i}", longest, 1), *good = json_pack("{s:i, s:i}", "height", 1, "width", 2);
    td_field root = {NULL, "f.yaml", object};
    check_fails(td_field_check_keys(&root, keys, &error), TD_ERROR_FORMAT, error, "known here are");
    root.value = good;
    check_ok(td_field_check_keys(&root, keys, &error), error);
    td_field leaf = td_field_get(&root, "width");
    check_fails(td_field_check_keys(&leaf, keys, &error), TD_ERROR_FORMAT, error,
                "f.yaml: width: must be a mapping, but is 2");
    json_decref(object);
    json_decref(good);
}

static void test_poses(void **state)
{
    (void)state;
    td_error error = {0};
    td_field root = {NULL, "f.yaml", field_root}, f = td_field_get(&root, "pose");
    td_pose pose;
    memset(&pose, 0xAA, sizeof pose);
    check_ok(td_field_pose(&pose, &f, &error), error);
    assert_true(pose.q[0] == 1 && pose.q[3] == 0 && pose.t[0] == 1 && pose.t[2] == 3);
    f = td_field_get(&root, "long");
    check_ok(td_field_pose(&pose, &f, &error), error);
    check_near(pose.q[0], 1, 1e-15);
    f = td_field_get(&root, "bent");
    check_fails(td_field_pose(&pose, &f, &error), TD_ERROR_FORMAT, error,
                "f.yaml: bent.q: must be a unit quaternion");
    f = td_field_get(&root, "zero");
    check_fails(td_field_pose(&pose, &f, &error), TD_ERROR_FORMAT, error, "its length is 0.0");
    f = td_field_get(&root, "euler");
    check_fails(td_field_pose(&pose, &f, &error), TD_ERROR_FORMAT, error, "f.yaml: euler: unknown key 'rpy'");
    f = td_field_get(&root, "a");
    check_fails(td_field_pose(&pose, &f, &error), TD_ERROR_FORMAT, error, "unknown key 'b'");
    f = td_field_get(&root, "nowhere");
    check_fails(td_field_pose(&pose, &f, &error), TD_ERROR_FORMAT, error,
                "f.yaml: nowhere: is missing; must be a mapping");
    /* Every quaternion that core/pose.h makes comes back bit for bit. */
    td_random random = td_random_seed(5, 5);
    for (int n = 0; n < 10000; n++) {
        double xi[6];
        for (int i = 0; i < 6; i++) xi[i] = 3 * td_random_normal(&random);
        td_pose made = td_pose_exp(xi), other = td_pose_exp(xi + 0);
        made = td_pose_compose(&made, &other);
        json_t *value =
            json_pack("{s:o, s:o}", "q", td_json_reals(made.q, 4), "t_m", td_json_reals(made.t, 3));
        td_field field = {NULL, "f.yaml", value};
        check_ok(td_field_pose(&pose, &field, &error), error);
        assert_memory_equal(&pose, &made, sizeof pose);
        json_decref(value);
    }
}

static void test_makers(void **state)
{
    (void)state;
    const double m[6] = {1, 2, NAN, 4, INFINITY, 6};
    json_t *value = td_json_matrix(m, 2, 3);
    char *text = json_dumps(value, JSON_COMPACT);
    assert_string_equal(text, "[[1.0,2.0,null],[4.0,null,6.0]]");
    free(text);
    json_decref(value);
    value = td_json_reals(m, 0);
    assert_int_equal(json_array_size(value), 0);
    json_decref(value);
    value = td_json_real(-0.5);
    assert_true(json_real_value(value) == -0.5);
    json_decref(value);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_scalars),
        cmocka_unit_test(test_layouts),
        cmocka_unit_test(test_what_is_refused),
        cmocka_unit_test(test_bounds),
        cmocka_unit_test_setup_teardown(test_read_from_a_file, scratch_make, scratch_remove),
        cmocka_unit_test(test_yaml_layout),
        cmocka_unit_test(test_quotes),
        cmocka_unit_test(test_digits),
        cmocka_unit_test(test_what_cannot_be_written),
        cmocka_unit_test(test_awkward_texts),
        cmocka_unit_test(test_random_trees_come_back),
        cmocka_unit_test(test_getters),
        cmocka_unit_test(test_getters_refuse),
        cmocka_unit_test(test_keys_and_suggestions),
        cmocka_unit_test(test_poses),
        cmocka_unit_test(test_makers),
    };
    return cmocka_run_group_tests(tests, fields_setup, fields_teardown);
}

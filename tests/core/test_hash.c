/* Proves that the hash is SHA-256, of bytes, of parts and of files. Reference: the example messages of FIPS
 * 180-4 (NIST's "SHA256" example values) and the million letters of its third; exact. Blind to files beyond 2
 * GiB. */
#include "core/hash.h"
#include "tests/check.h"
#include "tests/scratch.h"

static const struct {
    const char *text, *hex;
} vector[] = {
    {"", "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"},
    {"abc", "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"},
    {"abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq",
     "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1"},
};
static const char million_hex[] = "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0";

static void test_vectors(void **state)
{
    (void)state;
    td_error error = {0};
    char hex[TD_HASH_HEX_SIZE];
    for (size_t i = 0; i < sizeof vector / sizeof *vector; i++) {
        memset(hex, 'z', sizeof hex);
        check_ok(td_hash_bytes(hex, vector[i].text, strlen(vector[i].text), &error), error);
        assert_string_equal(hex, vector[i].hex);
    }
}

static void test_parts(void **state)
{
    (void)state;
    td_error error = {0};
    td_hash *hash = NULL;
    char hex[TD_HASH_HEX_SIZE], part[1000];
    memset(part, 'a', sizeof part);
    check_ok(td_hash_new(&hash, &error), error);
    for (int i = 0; i < 1000; i++) {
        size_t cut = (size_t)i % sizeof part;
        td_hash_add(hash, part, cut);
        td_hash_add(hash, part, sizeof part - cut);
    }
    check_ok(td_hash_finish(hex, &hash, &error), error);
    assert_null(hash);
    assert_string_equal(hex, million_hex);
    td_hash_free(&hash);
    td_hash_free(NULL);
}

static td_status add_letters(td_hash *hash, const void *user, td_error *error)
{
    const char *text = user;
    if (!*text) return td_fail(error, TD_ERROR_DATA, "no letters");
    for (; *text; text++) td_hash_add(hash, text, 1);
    return TD_OK;
}

static void test_made(void **state)
{
    (void)state;
    td_error error = {0};
    char hex[TD_HASH_HEX_SIZE];
    check_ok(td_hash_make(hex, add_letters, vector[2].text, &error), error);
    assert_string_equal(hex, vector[2].hex);
    check_fails(td_hash_make(hex, add_letters, "", &error), TD_ERROR_DATA, error, "no letters");
}

static void test_file(void **state)
{
    td_error error = {0};
    char hex[TD_HASH_HEX_SIZE], *path = td_path_join(*state, "million"), *bytes = malloc(1000000);
    memset(bytes, 'a', 1000000);
    check_ok(td_file_write(path, bytes, 1000000, &error), error);
    check_ok(td_hash_file(hex, path, &error), error);
    assert_string_equal(hex, million_hex);
    check_ok(td_file_write(path, "", 0, &error), error);
    check_ok(td_hash_file(hex, path, &error), error);
    assert_string_equal(hex, vector[0].hex);
    check_fails(td_hash_file(hex, *state, &error), TD_ERROR_IO, error, "is a folder");
    remove(path);
    check_fails(td_hash_file(hex, path, &error), TD_ERROR_IO, error, "No such file");
    free(bytes);
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_vectors),
        cmocka_unit_test(test_parts),
        cmocka_unit_test(test_made),
        cmocka_unit_test_setup_teardown(test_file, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

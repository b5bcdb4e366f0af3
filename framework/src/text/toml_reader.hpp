#pragma once
// Typed, checked access to a TOML table. Every failure is one line that names file, line and key; a key that nobody asked
// for is an error too, with the nearest known key as the suggestion.

#include <shadelab/error.hpp>

#include <glm/glm.hpp>
#define TOML_EXCEPTIONS 1
#include <toml++/toml.h>

#include <filesystem>
#include <limits>
#include <optional>
#include <set>
#include <string>
#include <vector>

namespace shadelab {

struct Range {
    double min = -std::numeric_limits<double>::infinity();
    double max = std::numeric_limits<double>::infinity();
    bool open_min = false;  ///< the minimum itself is not allowed
};

class TomlReader {
public:
    TomlReader(const toml::table& table, std::string file, std::string path)
        : table_(table), file_(std::move(file)), path_(std::move(path)) {}

    bool has(const std::string& key) const { return table_.contains(key); }
    const toml::node* find(const std::string& key);

    double number(const std::string& key, Range range = {});
    double number(const std::string& key, double otherwise, Range range);
    int integer(const std::string& key, int otherwise, int min, int max);
    std::string string(const std::string& key);
    std::string string(const std::string& key, const std::string& otherwise);
    std::string choice(const std::string& key, const std::string& otherwise, const std::vector<std::string>& allowed);
    std::vector<double> numbers(const std::string& key, int count, Range range = {});
    glm::dvec3 vec3(const std::string& key, Range range = {});
    glm::dvec3 vec3(const std::string& key, glm::dvec3 otherwise, Range range);
    std::vector<std::string> strings(const std::string& key);
    TomlReader child(const std::string& key);  ///< a required table
    std::optional<TomlReader> optional_child(const std::string& key);
    std::vector<TomlReader> children(const std::string& key);  ///< an array of tables; absent = empty
    std::vector<std::pair<std::string, TomlReader>> named_children(const std::string& key);  ///< [key.name] tables

    /// To be called when everything was read: throws for the first key that nobody asked for.
    void finish() const;
    /// Throws InputError at the key's line (at the table's, when the key is absent).
    [[noreturn]] void fail(const std::string& key, const std::string& what) const;
    std::string where(const std::string& key) const;

private:
    TomlReader table_at(const toml::node& node, const std::string& path, const std::string& key) const;

    const toml::table& table_;
    std::string file_, path_;
    std::set<std::string> known_;
};

/// Parses a file; syntax errors become an InputError with file and line.
toml::table parse_toml(const std::filesystem::path& file);

/// The candidate that is nearest to `word` when it is near enough to be a slip of the pen, otherwise "".
std::string nearest(const std::string& word, const std::vector<std::string>& candidates);

/// "a, b or c"
std::string list_of(const std::vector<std::string>& words);

}  // namespace shadelab

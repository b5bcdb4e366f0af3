#include "text/toml_reader.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <sstream>

namespace shadelab {

namespace {

std::string shortest(double value) {
    std::ostringstream out;
    out << value;
    return out.str();
}

const char* kind_of(const toml::node& node) {
    switch (node.type()) {
        case toml::node_type::table:
            return "a table";
        case toml::node_type::array:
            return "an array";
        case toml::node_type::string:
            return "a string";
        case toml::node_type::integer:
        case toml::node_type::floating_point:
            return "a number";
        case toml::node_type::boolean:
            return "true or false";
        default:
            return "a date";
    }
}

int edit_distance(const std::string& a, const std::string& b) {
    std::vector<int> row(b.size() + 1);
    for (size_t j = 0; j <= b.size(); ++j) row[j] = int(j);
    for (size_t i = 1; i <= a.size(); ++i) {
        int diagonal = row[0];
        row[0] = int(i);
        for (size_t j = 1; j <= b.size(); ++j) {
            const int above = row[j];
            row[j] = std::min({above + 1, row[j - 1] + 1, diagonal + (a[i - 1] != b[j - 1])});
            diagonal = above;
        }
    }
    return row[b.size()];
}

}  // namespace

std::string nearest(const std::string& word, const std::vector<std::string>& candidates) {
    std::string best;
    int best_distance = 3;  // more than two slips is another word
    for (const std::string& candidate : candidates) {
        const int distance = edit_distance(word, candidate);
        if (distance < best_distance && distance < int(candidate.size())) {
            best_distance = distance;
            best = candidate;
        }
    }
    return best;
}

std::string list_of(const std::vector<std::string>& words) {
    std::string out;
    for (size_t i = 0; i < words.size(); ++i) {
        if (i > 0) out += i + 1 == words.size() ? " or " : ", ";
        out += words[i];
    }
    return out;
}

toml::table parse_toml(const std::filesystem::path& file) {
    std::ifstream in(file);
    if (!in || std::filesystem::is_directory(file))
        throw InputError(file.string() + ": cannot be read; does the file exist?");
    try {
        return toml::parse(in, file.string());
    } catch (const toml::parse_error& error) {
        std::string what(error.description());
        std::replace(what.begin(), what.end(), '\n', ' ');
        throw InputError(file.string() + ":" + std::to_string(error.source().begin.line) + ": not valid TOML: " + what);
    }
}

std::string TomlReader::where(const std::string& key) const {
    const toml::node* node = table_.get(key);
    const auto line = (node ? node->source() : table_.source()).begin.line;
    // A file's top table has no position of its own: "line 0" would mislead.
    return file_ + (line > 0 ? ":" + std::to_string(line) : "") + ": " + (path_.empty() ? key : path_ + "." + key);
}

void TomlReader::fail(const std::string& key, const std::string& what) const {
    std::string line = where(key) + ": " + what;
    std::replace_if(
        line.begin(), line.end(), [](char c) { return c == '\n' || c == '\r'; }, ' ');  // quoted strings may hold some
    throw InputError(line);
}

const toml::node* TomlReader::find(const std::string& key) {
    known_.insert(key);
    return table_.get(key);
}

double TomlReader::number(const std::string& key, Range range) {
    const toml::node* node = find(key);
    if (!node) fail(key, "is missing; give a number");
    const auto value = node->value<double>();
    if (!value || node->is_boolean()) fail(key, std::string("must be a number, not ") + kind_of(*node));
    if (!std::isfinite(*value)) fail(key, "must be finite");
    if (*value < range.min || *value > range.max || (range.open_min && *value == range.min)) {
        std::string bounds;
        if (std::isfinite(range.min)) bounds += (range.open_min ? "above " : "at least ") + shortest(range.min);
        if (std::isfinite(range.max)) bounds += (bounds.empty() ? "" : " and ") + ("at most " + shortest(range.max));
        fail(key, "must be " + bounds + ", not " + shortest(*value));
    }
    return *value;
}

double TomlReader::number(const std::string& key, double otherwise, Range range) {
    return find(key) ? number(key, range) : otherwise;
}

int TomlReader::integer(const std::string& key, int otherwise, int min, int max) {
    const toml::node* node = find(key);
    if (!node) return otherwise;
    if (!node->is_integer()) fail(key, std::string("must be a whole number, not ") + kind_of(*node));
    return int(number(key, Range{double(min), double(max)}));
}

std::string TomlReader::string(const std::string& key) {
    const toml::node* node = find(key);
    if (!node) fail(key, "is missing; give a string");
    if (!node->is_string()) fail(key, std::string("must be a string, not ") + kind_of(*node));
    return *node->value<std::string>();
}

std::string TomlReader::string(const std::string& key, const std::string& otherwise) {
    return find(key) ? string(key) : otherwise;
}

std::string TomlReader::choice(const std::string& key, const std::string& otherwise,
                               const std::vector<std::string>& allowed) {
    if (!find(key) && !otherwise.empty()) return otherwise;
    const std::string value = string(key);
    if (std::find(allowed.begin(), allowed.end(), value) == allowed.end())
        fail(key, "must be " + list_of(allowed) + ", not \"" + value + "\"");
    return value;
}

std::vector<double> TomlReader::numbers(const std::string& key, int count, Range range) {
    const toml::node* node = find(key);
    if (!node) fail(key, "is missing; give an array of " + std::to_string(count) + " numbers");
    const toml::array* array = node->as_array();
    if (!array) fail(key, "must be an array of " + std::to_string(count) + " numbers, not " + kind_of(*node));
    if (int(array->size()) != count)
        fail(key, "must hold " + std::to_string(count) + " numbers, not " + std::to_string(array->size()));
    std::vector<double> out;
    for (const toml::node& element : *array) {
        // Checked through a table of one key, so that the messages of number() serve here too.
        toml::table one;
        one.insert(key, element);
        try {
            out.push_back(TomlReader(one, file_, path_).number(key, range));
        } catch (const InputError& error) {
            const std::string text = error.what();
            fail(key, "each number " + text.substr(text.find("must be")));
        }
    }
    return out;
}

glm::dvec3 TomlReader::vec3(const std::string& key, Range range) {
    const std::vector<double> values = numbers(key, 3, range);
    return {values[0], values[1], values[2]};
}

glm::dvec3 TomlReader::vec3(const std::string& key, glm::dvec3 otherwise, Range range) {
    return find(key) ? vec3(key, range) : otherwise;
}

std::vector<std::string> TomlReader::strings(const std::string& key) {
    const toml::node* node = find(key);
    std::vector<std::string> out;
    if (!node) return out;
    const toml::array* array = node->as_array();
    if (!array) fail(key, std::string("must be an array of strings, not ") + kind_of(*node));
    for (const toml::node& element : *array) {
        const auto value = element.value<std::string>();
        if (!value) fail(key, std::string("must hold strings only, not ") + kind_of(element));
        out.push_back(*value);
    }
    return out;
}

TomlReader TomlReader::table_at(const toml::node& node, const std::string& path, const std::string& key) const {
    const toml::table* table = node.as_table();
    if (!table) fail(key, std::string("must be a table, not ") + kind_of(node));
    return TomlReader(*table, file_, path);
}

TomlReader TomlReader::child(const std::string& key) {
    const toml::node* node = find(key);
    if (!node) {
        // A slip of the pen is more likely than that the whole table was forgotten.
        for (const auto& [name, other] : table_)
            if (!known_.count(std::string(name.str())) && nearest(std::string(name.str()), {key}) == key)
                fail(std::string(name.str()), "unknown key; did you mean \"" + key + "\"?");
        fail(key, "is missing; add a [" + key + "] table");
    }
    return table_at(*node, path_.empty() ? key : path_ + "." + key, key);
}

std::optional<TomlReader> TomlReader::optional_child(const std::string& key) {
    return find(key) ? std::optional<TomlReader>(child(key)) : std::nullopt;
}

std::vector<TomlReader> TomlReader::children(const std::string& key) {
    std::vector<TomlReader> out;
    const toml::node* node = find(key);
    if (!node) return out;
    const toml::array* array = node->as_array();
    if (!array) fail(key, "must be an array of tables: write [[" + key + "]]");
    for (const toml::node& element : *array)
        out.push_back(table_at(element, key + "[" + std::to_string(out.size()) + "]", key));
    return out;
}

std::vector<std::pair<std::string, TomlReader>> TomlReader::named_children(const std::string& key) {
    std::vector<std::pair<std::string, TomlReader>> out;
    auto parent = optional_child(key);
    if (!parent) return out;
    for (const auto& [name, node] : parent->table_) {
        const std::string child_name(name.str());
        if (!node.is_table())
            throw InputError(file_ + ":" + std::to_string(node.source().begin.line) + ": " + key + "." + child_name +
                             ": must be a table, not " + kind_of(node));
        out.emplace_back(child_name, TomlReader(*node.as_table(), file_, key + "." + child_name));
    }
    return out;
}

void TomlReader::finish() const {
    for (const auto& [name, node] : table_) {
        const std::string key(name.str());
        if (known_.count(key)) continue;
        const std::vector<std::string> known(known_.begin(), known_.end());
        const std::string guess = nearest(key, known);
        fail(key,
             "unknown key; " + (guess.empty() ? "known here: " + list_of(known) : "did you mean \"" + guess + "\"?"));
    }
}

}  // namespace shadelab

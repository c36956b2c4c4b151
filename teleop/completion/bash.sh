_teleop() {
    local word line reply rest given i words=() ends=
    # bash splits words at = and :, which here are parts of one word.
    for ((i = 1; i <= COMP_CWORD; i++)); do
        word=${COMP_WORDS[i]}
        if ((${#words[@]})) && [[ $word == [=:]* || ${words[-1]} == *[=:] ]]; then
            words[-1]+=$word
        else
            words+=("$word")
        fi
    done
    word=${words[-1]}
    unset 'words[-1]'
    rest=${word##*[=,]}
    given=
    [[ $COMP_WORDBREAKS != *=* ]] || given=${word%"${word##*[=:]}"} # what bash keeps by itself
    COMPREPLY=()
    while IFS= read -r line; do
        case $line in
            $'\t'folders* | $'\t'files*)
                compopt -o filenames 2>/dev/null
                while IFS= read -r reply; do
                    reply=${word%"$rest"}$reply
                    COMPREPLY+=("${reply#"$given"}")
                done < <(compgen -d -- "$rest"
                    [[ $line == $'\t'folders* ]] || compgen -f -X "!${line##*$'\t'}" -- "$rest") ;;
            *)
                reply=${line%%$'\t'*}
                [[ $reply != *= ]] || ends==
                COMPREPLY+=("${reply#"$given"}") ;;
        esac
    done < <(_teleop_complete "$word" "${words[@]}")
    [[ -z $ends ]] || compopt -o nospace 2>/dev/null
}
complete -F _teleop teleop
